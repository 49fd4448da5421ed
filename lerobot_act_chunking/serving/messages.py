"""What LeRobot's robot client sends, read without trusting it."""

import io
import pickle
from typing import Any

from lerobot_act_chunking.errors import ActChunkingError

_NUMPY = ("numpy", "numpy.core.multiarray", "numpy._core.multiarray", "numpy._core.numeric")
EXPECTED = {
    ("lerobot.async_inference.helpers", "RemotePolicyConfig"),
    ("lerobot.async_inference.helpers", "TimedObservation"),
    ("lerobot.configs.types", "PolicyFeature"),
    ("lerobot.configs.types", "FeatureType"),
    ("collections", "OrderedDict"),
    *((module, name) for module in _NUMPY for name in ("ndarray", "dtype", "_reconstruct", "scalar")),
    *((module, "_frombuffer") for module in _NUMPY),
}
"""All that an observation or a request for a policy is made of, beside numbers, texts, lists and mappings."""


class MessageError(ActChunkingError):
    """A message that is no observation and no request for a policy."""


class _Reader(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in EXPECTED:
            raise MessageError(
                f"a client sent {module}.{name}, which is no part of an observation: it was not loaded, "
                "since a pickle may run any code"
            )
        return super().find_class(module, name)


def read(message: bytes) -> Any:
    """The object that a client pickled.

    Raises:
        MessageError: it is made of anything that was not expected, or damaged.
    """
    try:
        return _Reader(io.BytesIO(message)).load()
    except MessageError:
        raise
    except Exception as error:
        raise MessageError(f"a client sent {len(message)} bytes that cannot be read: {error}") from error
