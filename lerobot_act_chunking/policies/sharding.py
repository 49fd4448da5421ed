"""What those must know of a policy that train it on several devices."""

from typing import Any


class ShardsByLayer:
    """For FSDP: layers that are gathered one after the other; all the rest of a policy is gathered as one."""

    _fsdp_wrap_modules: list[str]
    """Classes of these layers, by LeRobot 0.7's name; a layer is used by its ``forward`` alone."""
    _fsdp_forward_methods = ("select_action", "predict_action_chunk", "predict_samples")
    """What may be called beside ``forward`` (LeRobot 0.7)."""

    @property
    def _no_split_modules(self) -> list[str]:
        """The same for accelerate's ``TRANSFORMER_BASED_WRAP``, which refuses classes that are not there."""
        policy: Any = self
        present = {type(each).__name__ for each in policy.modules()}
        return sorted(present & set(self._fsdp_wrap_modules))

    @property
    def _ddp_params_and_buffers_to_ignore(self) -> list[str]:
        """For DDP: numbers that stay on the CPU (`CountsOnCpu`), where its processes cannot exchange them.

        They are the same in all.
        """
        policy: Any = self
        device = next(policy.parameters()).device
        return [name for name, each in policy.named_buffers() if each.device != device]
