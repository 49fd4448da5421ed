"""A model hub that is a folder: pushes and loads of LeRobot, without a network or an account."""

from lerobot_act_chunking.hub.routing import FALL_THROUGH, LOCAL_HUB, configured_hub, install

__all__ = ["FALL_THROUGH", "LOCAL_HUB", "configured_hub", "install"]
