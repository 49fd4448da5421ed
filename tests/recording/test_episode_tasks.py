"""Episodes with an instruction of their own."""

import numpy as np
from lerobot.datasets.dataset_metadata import LeRobotDatasetMetadata

from lerobot_act_chunking.recording.assembly import DatasetAssembly
from lerobot_act_chunking.recording.episode import DatasetFormat, Episode
from lerobot_act_chunking.recording.staging import EpisodeStore

FEATURES = {"action": {"dtype": "float32", "shape": (1,), "names": ["joint"]}}


def test_they_keep_it_from_the_attempt_to_the_dataset(tmp_path):
    store = EpisodeStore(tmp_path / "episodes")
    store.folder.mkdir()
    form = DatasetFormat(10, "usual", "arm", FEATURES)
    with DatasetAssembly(tmp_path / "data", "test/toy", form) as assembly:
        for seed, task in enumerate((None, "left", "right", "left")):
            store.save(Episode(seed, True, {"action": np.ones((3, 1), np.float32)}, task=task))
            assembly.add(store.load(seed))
        assembly.finish({})
    meta = LeRobotDatasetMetadata("test/toy", root=tmp_path / "data")
    assert list(meta.tasks.index) == ["usual", "left", "right"]
    assert [list(each) for each in meta.episodes["tasks"]] == [["usual"], ["left"], ["right"], ["left"]]
