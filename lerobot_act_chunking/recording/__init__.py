"""Recording demonstrations into LeRobotDatasets.

``record(RecordSpec(...))`` plays a scripted expert and keeps its successes; ``record_source`` does the same
for any ``EpisodeSource``. ``read_summary`` tells how a dataset was recorded.
"""

from lerobot_act_chunking.recording.aloha import AlohaSource
from lerobot_act_chunking.recording.demonstrations import record
from lerobot_act_chunking.recording.episode import DatasetFormat, Episode, EpisodeSource
from lerobot_act_chunking.recording.recorder import RecordingProgress, RecordResult, Target, record_source
from lerobot_act_chunking.recording.robotics import RoboticsSource
from lerobot_act_chunking.recording.shares import ModeShares
from lerobot_act_chunking.recording.simulated import SimulatedSource
from lerobot_act_chunking.recording.so_arm import SoArmSource
from lerobot_act_chunking.recording.spec import RecordSpec
from lerobot_act_chunking.recording.summary import RecordedEpisode, RecordingSummary, read_summary
from lerobot_act_chunking.recording.three_gates import ThreeGatesSource

__all__ = [
    "AlohaSource",
    "DatasetFormat",
    "Episode",
    "EpisodeSource",
    "ModeShares",
    "RecordResult",
    "RecordSpec",
    "RecordedEpisode",
    "RecordingProgress",
    "RecordingSummary",
    "RoboticsSource",
    "SimulatedSource",
    "SoArmSource",
    "Target",
    "ThreeGatesSource",
    "read_summary",
    "record",
    "record_source",
]
