"""Work items, such as episodes, done in this process, in processes of this machine, or on a Ray cluster."""

from lerobot_act_chunking.executors.executor import Executor, Open, Places, each_done
from lerobot_act_chunking.executors.opening import Cluster, open_executor

__all__ = ["Cluster", "Executor", "Open", "Places", "each_done", "open_executor"]
