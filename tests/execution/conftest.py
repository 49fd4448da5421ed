import jaxtyping
import pytest


@pytest.fixture
def unchecked(monkeypatch):
    """As users run it: no type checker refuses a value first, or takes ten times as long as the code."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
