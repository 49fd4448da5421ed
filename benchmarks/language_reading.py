"""What instructions tell, read word by word or as the mean of their words: why `words` is the default.

    python benchmarks/language_reading.py

The readers of `language_reading` with a small network behind them learn which of the six goals of
`language_transfer` an instruction means, from as many sentences as 200 demonstrations have, and are asked
about the held-out paraphrases. No robot moves. Writes benchmarks/results/language_reading.json and the table
of docs/guides/language.md (a test compares).
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from mode_study import show_on
from torch import Tensor, nn

from lerobot_act_chunking.durable_files import write_atomically
from lerobot_act_chunking.envs.aloha.instructions import GOALS, draw_goal, draw_phrase, phrases
from lerobot_act_chunking.nn.instruction import READERS
from lerobot_act_chunking.policies.language.encoder import MINILM, load_encoder

ROOT = Path(__file__).parents[1]
RESULTS, PAGE = ROOT / "benchmarks/results/language_reading.json", ROOT / "docs/guides/language.md"
MARK = "<!-- reading: python benchmarks/language_reading.py -->"
EPISODES, TOKENS, STEPS, BATCH, HIDDEN = 200, 32, 500, 64, 128


class Sentences:
    """What the encoder says of sentences, and which goal each means."""

    def __init__(self, said: dict[str, int]):
        encoder = load_encoder(MINILM)
        self.states = torch.zeros(len(said), TOKENS, encoder.width)
        self.mask = torch.zeros(len(said), TOKENS, dtype=torch.bool)
        self.goals = torch.tensor(list(said.values()))
        for row, sentence in enumerate(said):
            tokens = encoder.tokens(sentence, TOKENS)
            self.states[row, : len(tokens)] = encoder.states(tokens)
            self.mask[row, : len(tokens)] = True

    def right(self, model: "Classifier") -> dict[str, float]:
        """Shares whose goal, whose cube and whose direction a classifier tells."""
        with torch.no_grad():
            told = model(self).argmax(1)
        pairs = {
            "goal": told == self.goals,
            "cube": told // 2 == self.goals // 2,
            "direction": told % 2 == self.goals % 2,
        }
        return {name: round(each.float().mean().item(), 4) for name, each in pairs.items()}


class Classifier(nn.Module):
    def __init__(self, kind: str, width: int):
        super().__init__()
        self.reader = READERS[kind](width)
        hidden = nn.Linear(self.reader.dim, HIDDEN)
        self.head = nn.Sequential(hidden, nn.ReLU(), nn.Linear(HIDDEN, len(GOALS)))

    def forward(self, said: Sentences, rows: Tensor | slice = slice(None)) -> Tensor:
        return self.head(self.reader(said.states[rows], said.mask[rows]))


def learn(kind: str, seed: int, said: Sentences) -> Classifier:
    torch.manual_seed(seed)
    model = Classifier(kind, said.states.shape[-1])
    model.reader.fit(said.states, said.mask)
    optimizer = torch.optim.AdamW(model.parameters(), 1e-3)
    for _ in range(STEPS):
        rows = torch.randint(len(said.goals), (BATCH,))
        loss = nn.functional.cross_entropy(model(said, rows), said.goals[rows])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return model


def recorded() -> dict[str, int]:
    """As many sentences as demonstrations draw."""
    rng = np.random.default_rng(0)
    drawn = [draw_goal(rng) for _ in range(EPISODES)]
    return {draw_phrase(goal, "seen", rng): GOALS.index(goal) for goal in drawn}


def table(rows: list[dict[str, Any]]) -> str:
    lines = ["| `language_reading` | right goal | right cube | right direction |", "|---|---|---|---|"]
    for kind in READERS:
        of_kind = [row["unseen"] for row in rows if row["reading"] == kind]
        shares = (", ".join(f"{100 * each[name]:.0f}" for each in of_kind) for name in of_kind[0])
        lines.append(f"| `{kind}` | {' % | '.join(shares)} % |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    args = parser.parse_args()
    seen = Sentences(recorded())
    unseen = Sentences({say: number for number, goal in enumerate(GOALS) for say in phrases(goal, "unseen")})
    rows = [
        {
            "reading": kind,
            "seed": seed,
            "sentences": len(seen.goals),
            "seen": seen.right(model),
            "unseen": unseen.right(model),
        }
        for kind in READERS
        for seed in args.seeds
        for model in [learn(kind, seed, seen)]
    ]
    write_atomically(RESULTS, (json.dumps(rows, indent=1) + "\n").encode())
    show_on(PAGE, MARK, table(rows))


if __name__ == "__main__":
    main()
