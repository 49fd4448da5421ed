"""Finished episodes are kept: a race that was stopped goes on to the result of one that was not."""

import pytest

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.core.outcomes import FILE
from lerobot_act_chunking.diagnostics.tune.candidates import Candidate
from lerobot_act_chunking.diagnostics.tune.racing import race
from lerobot_act_chunking.diagnostics.tune.store import Store
from lerobot_act_chunking.errors import ConfigurationError

QUESTION = {"checkpoint": "abc", "environment": {"type": "line"}, "seed": 7}
SETTINGS = ExecutionSettings(chunk_size=8)
CANDIDATES = [Candidate((("n_action_steps", n),), SETTINGS) for n in range(1, 6)]


class StoppedError(Exception):
    pass


def evaluator(run, most=None):
    """Succeeds by a rule; notes in ``run`` what it was asked, and is stopped after ``most`` cells."""

    def evaluate(cells):
        for cell in cells:
            if most is not None and len(run) >= most:
                raise StoppedError
            run.append(cell)
            (_, n), *_ = cell.candidate.values
            yield cell, [at % 7 < n for at in range(cell.start, cell.start + cell.n)]

    return evaluate


def test_a_stopped_race_goes_on_to_the_same_result(tmp_path):
    whole, before, after = [], [], []
    expected = race(CANDIDATES, evaluator(whole), 100)
    with pytest.raises(StoppedError):
        race(CANDIDATES, Store(QUESTION, tmp_path).remembering(evaluator(before, most=4)), 100)
    found = race(CANDIDATES, Store(QUESTION, tmp_path).remembering(evaluator(after)), 100)
    assert (found.results, found.dropped) == (expected.results, expected.dropped)
    assert before + after == whole
    assert len(before) == 4


def test_the_folder_follows_from_the_question(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert Store(QUESTION, None).folder == Store(dict(reversed(QUESTION.items())), None).folder
    assert Store(QUESTION, None).folder != Store({**QUESTION, "seed": 8}, None).folder


def test_episodes_of_another_question_are_refused(tmp_path):
    Store(QUESTION, tmp_path).put("two", [True, False])
    assert Store(QUESTION, tmp_path).get("two") == [True, False]
    with pytest.raises(ConfigurationError, match=r"another checkpoint and seed: choose another --output-dir"):
        Store({**QUESTION, "seed": 8, "checkpoint": "abd"}, tmp_path)


@pytest.mark.parametrize("content", ["", "[]", '{"question": {}}'])
def test_a_damaged_file_is_refused(content, tmp_path):
    (tmp_path / FILE).write_text(content)
    with pytest.raises(ConfigurationError, match=r"cannot be read .*: remove it, or choose another"):
        Store(QUESTION, tmp_path)
