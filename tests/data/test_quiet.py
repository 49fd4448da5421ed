import importlib
import logging

from lerobot.utils.import_utils import get_safe_default_video_backend

from lerobot_act_chunking.data.quiet import quiet_missing_ffmpeg


def test_a_missing_ffmpeg_is_a_debug_message(monkeypatch, caplog):
    def fails(name):
        raise RuntimeError("Could not load libtorchcodec\n" + "traceback\n" * 80)

    quiet_missing_ffmpeg()
    quiet_missing_ffmpeg()
    monkeypatch.setattr(importlib, "import_module", fails)
    with caplog.at_level(logging.DEBUG):
        assert get_safe_default_video_backend() == "pyav"
    assert [record.levelname for record in caplog.records] == ["DEBUG"]
    assert len(logging.getLogger("lerobot.utils.import_utils").filters) == 1


def test_other_warnings_of_the_same_logger_are_kept(caplog):
    quiet_missing_ffmpeg()
    with caplog.at_level(logging.WARNING):
        logging.getLogger("lerobot.utils.import_utils").warning("a plugin could not be imported")
    assert [record.levelname for record in caplog.records] == ["WARNING"]
