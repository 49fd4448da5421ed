"""One warning of LeRobot that has no place on the screen of somebody who uses no videos."""

import logging


def quiet_missing_ffmpeg() -> None:
    """Turns LeRobot's warning about an unusable torchcodec into a debug message; harmless when repeated.

    On a machine without FFmpeg LeRobot logs torchcodec's five tracebacks (80 lines) whenever it picks a video
    decoder, even for datasets without videos, and then decodes with PyAV, which brings its own FFmpeg. What
    it picked still shows as ``video_backend`` in the configuration that ``lerobot-train`` prints.
    """
    # addFilter ignores a filter that is there already.
    logging.getLogger("lerobot.utils.import_utils").addFilter(_demote_torchcodec)


def _demote_torchcodec(record: logging.LogRecord) -> bool:
    if "torchcodec" not in record.getMessage():
        return True
    record.levelno, record.levelname = logging.DEBUG, logging.getLevelName(logging.DEBUG)
    # Handlers often take every level, because loggers have asked before; ask again for the new level.
    return logging.getLogger(record.name).isEnabledFor(logging.DEBUG)
