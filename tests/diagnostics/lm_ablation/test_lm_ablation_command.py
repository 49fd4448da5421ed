"""`act-chunking lm-ablation` from demonstrations to a report, with a tiny language model."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tiny_bert import DIM, HEADS, HIDDEN, LAYERS, PLACES, VOCABULARY, tiny_bert

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.diagnostics.lm_ablation import corpus
from lerobot_act_chunking.diagnostics.lm_ablation.corpus import Tokenizer, read_corpus

ROOT = Path(__file__).parents[3]
SPECIAL = ("[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]")
TEXT = "leave through the top gate left right hand upper take is yours go out by high a of to"
WORDS = (*SPECIAL, *TEXT.split())
SIZES = {"dim_model": DIM, "n_heads": HEADS, "dim_feedforward": HIDDEN, "n_encoder_layers": LAYERS}


@pytest.fixture(scope="module")
def language_model(tmp_path_factory):
    tokenizers = pytest.importorskip("tokenizers")
    folder = tmp_path_factory.mktemp("language_model")
    tiny_bert(folder)
    words = [*WORDS, *(f"w{number}" for number in range(VOCABULARY - len(WORDS)))]
    own = tokenizers.Tokenizer(
        tokenizers.models.WordLevel({word: i for i, word in enumerate(words)}, unk_token="[UNK]")
    )
    own.pre_tokenizer = tokenizers.pre_tokenizers.Whitespace()
    own.post_processor = tokenizers.processors.BertProcessing(("[SEP]", 3), ("[CLS]", 2))
    own.save(str(folder / "tokenizer.json"))
    return folder


def test_the_text_and_its_scrambles(language_model, monkeypatch):
    monkeypatch.setattr(corpus, "MOST_PIECES", 400)
    tokenizer = Tokenizer(language_model, PLACES)
    text, shuffled, chain = (
        read_corpus(tokenizer, kind, np.random.default_rng(0)) for kind in ("text", "shuffled", "markov")
    )
    assert len(text) == len(chain) == 400
    assert sorted(text) == sorted(shuffled)
    assert list(text) != list(shuffled)
    pairs = set(pairwise(text.tolist()))
    followed = [(one, other) in pairs for one, other in pairwise(chain.tolist())]
    assert np.mean(followed) > 0.95  # but for the last piece of the text, which nothing follows
    assert list(chain) != list(text)
    told = tokenizer(["leave through the top gate", "take the left gate"])
    assert told.tokens[1, :6].tolist() == [2, 14, 7, 10, 9, 3]
    assert told.is_pad.sum(1).tolist() == [PLACES - 7, PLACES - 6]


def test_from_demonstrations_to_a_report(language_model, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(corpus, "MOST_PIECES", 400)
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    named_gates = pytest.importorskip("named_gates")
    named_gates.record(tmp_path / "data", 4)
    command = [
        *("lm-ablation", str(tmp_path / "data"), "--env.type=named_gates", "--shift", "instructions=words"),
        *("--env.discover_packages_path=named_gates", "--language-model", str(language_model)),
        *("--sizes", "2", "--seeds", "0", "--held-out", "1", "--text-tokens", str(PLACES)),
        *("--steps", "2", "--looks", "1", "--batch-size", "2", "--episodes", "2", "--pretraining-steps", "2"),
        *(f"--policy.{name}={value}" for name, value in SIZES.items()),
        "--policy.optimizer_lr=5e-4",  # to YAML a text
        *("--policy.chunk_size=20", "--policy.execution=open_loop"),
        *("--output-dir", str(tmp_path / "out"), "--json", str(tmp_path / "found.json")),
    ]
    cells = ["--cells", "T-R,T-LM',M-R,M-LM',T-shuffled"]
    assert main([*command, *cells]) == 11  # at this width an MLP over tokens counts
    told = capsys.readouterr().out
    assert "report.md" in told
    found = json.loads((tmp_path / "found.json").read_text())
    assert [row["trainings"] for row in found["cells"]] == [1] * 5
    assert {each["condition"] for each in found["effects"]} == {"as demonstrated", "instructions=words"}
    assert found["trainings"][0]["curve"][0][0] == 0
    assert set(found["trainings"][0]["successes"]["as demonstrated"]) <= {"0", "1"}
    assert (tmp_path / "out" / "report.png").stat().st_size > 10_000
    trained = {each: each.stat().st_mtime_ns for each in (tmp_path / "out" / "trainings").iterdir()}
    assert len(trained) == 5
    main([*command, "--cells", "T-R"])  # nothing is trained again, and the report is of all
    assert {each: each.stat().st_mtime_ns for each in trained} == trained
    again = json.loads((tmp_path / "found.json").read_text())
    assert again == found
    assert main([*command, *cells, "--seed", "7"]) == 1
    assert "trainings of another seed" in capsys.readouterr().err
    assert main([*command, "--policy.widht=3"]) == 1
    assert "act_chunked does not take --policy.widht=3" in capsys.readouterr().err
    assert main([*command[:-4], "--output-dir", str(tmp_path / "none"), "--sizes", "9"]) == 1
    assert "sizes=9: the dataset has 4 demonstrations" in capsys.readouterr().err


def test_it_needs_an_environment(capsys, tmp_path):
    assert main(["lm-ablation", str(tmp_path)]) == 1
    assert "give --env.type" in capsys.readouterr().err
