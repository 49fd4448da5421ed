import importlib
import logging

import pytest
from lerobot.utils.import_utils import get_safe_default_video_backend

from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg


@pytest.fixture
def picked(monkeypatch, caplog):
    """What a handler for all levels gets to see when LeRobot picks a decoder on a machine without FFmpeg."""

    def pick(level: int) -> list[str]:
        def fails(name):
            raise RuntimeError("Could not load libtorchcodec\n" + "traceback\n" * 80)

        quiet_missing_ffmpeg()
        quiet_missing_ffmpeg()
        monkeypatch.setattr(importlib, "import_module", fails)
        caplog.set_level(level)
        caplog.handler.setLevel(logging.NOTSET)
        assert get_safe_default_video_backend() == "pyav"
        return [record.levelname for record in caplog.records]

    return pick


def test_a_missing_ffmpeg_is_no_warning(picked):
    assert picked(logging.INFO) == []


def test_a_missing_ffmpeg_is_a_debug_message(picked):
    assert picked(logging.DEBUG) == ["DEBUG"]
    assert len(logging.getLogger("lerobot.utils.import_utils").filters) == 1


def test_other_warnings_of_the_same_logger_are_kept(caplog):
    quiet_missing_ffmpeg()
    with caplog.at_level(logging.WARNING):
        logging.getLogger("lerobot.utils.import_utils").warning("a plugin could not be imported")
    assert [record.levelname for record in caplog.records] == ["WARNING"]
