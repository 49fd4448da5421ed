"""Encoders that are pretrained here, all on the same text, for as many steps."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

from lerobot_act_chunking.diagnostics.lm_ablation.cells import Student
from lerobot_act_chunking.diagnostics.lm_ablation.corpus import Tokenizer, masked, read_corpus, windows
from lerobot_act_chunking.durable_files import publish, scratch_path
from lerobot_act_chunking.nn.language.encoder import TextEncoder, TextEncoderSpec
from lerobot_act_chunking.nn.language.make import make_text_encoder
from lerobot_act_chunking.nn.language.text import Text
from lerobot_act_chunking.nn.language.weights import WEIGHTS, save, start

BATCH, RATE, WARMUP = 16, 5e-4, 50


def pretrain(
    student: Student,
    spec: TextEncoderSpec,
    language_model: Path,
    folder: Path,
    steps: int,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """The folder of a pretrained encoder; it is made unless it is there.

    Args:
        student: which.
        spec: of an encoder for text alone.
        language_model: the teacher's folder, with the tokenizer.
        folder: of all students.
        steps: of training, with batches of 16.
        progress: called with the numbers of steps done and planned.
    """
    place = folder / student.name
    if (place / WEIGHTS).is_file():
        return place
    shutil.rmtree(place, ignore_errors=True)
    tokenizer = Tokenizer(language_model, spec.text_tokens)
    rng, generator = np.random.default_rng(0), torch.Generator().manual_seed(0)
    corpus = read_corpus(tokenizer, student.kind, rng)
    with torch.random.fork_rng([]):
        torch.manual_seed(0)
        encoder = make_text_encoder(student.architecture, spec)
    teacher = None
    if student.objective == "distilled":
        teacher = _teacher(spec, language_model, generator)
        assert encoder.words is not None  # noqa: S101
        assert teacher.words is not None  # noqa: S101
        encoder.words.load_state_dict(teacher.words.state_dict())
    else:
        encoder.requires_grad_(True)
    learning = [each for each in encoder.parameters() if each.requires_grad]
    optimizer = torch.optim.AdamW(learning, RATE, weight_decay=0.01, fused=True)
    for step in range(steps):
        rate = RATE * min(1, (step + 1) / WARMUP) * (1 - step / steps)
        for group in optimizer.param_groups:
            group["lr"] = rate
        text = windows(corpus, tokenizer, BATCH, rng)
        loss = (
            _masked(encoder, text, tokenizer.mask, generator)
            if teacher is None
            else _distilled(encoder, teacher, text)
        )
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(learning, 1.0)
        optimizer.step()
        if progress is not None:
            progress(step + 1, steps)
    with scratch_path(folder) as scratch:
        save(encoder, student.architecture, scratch)
        publish(scratch, place)
    return place


def _teacher(spec: TextEncoderSpec, folder: Path, generator: torch.Generator) -> TextEncoder:
    teacher = make_text_encoder("bert", spec)
    start(teacher, folder, "language_model", generator)
    return teacher.eval().requires_grad_(False)


def _distilled(encoder: TextEncoder, teacher: TextEncoder, text: Text) -> Tensor:
    """How far all states of all word pieces are from the teacher's: squares and angles."""
    with torch.no_grad():
        wanted = torch.stack(teacher.read(text))
    states = torch.stack(encoder.read(text))
    return F.mse_loss(states, wanted) + 1 - F.cosine_similarity(states, wanted, dim=-1).mean()


def _masked(encoder: TextEncoder, text: Text, mask: int, generator: torch.Generator) -> Tensor:
    """How unlikely the word pieces that were left out are."""
    assert encoder.words is not None  # noqa: S101
    shown, hidden = masked(text, mask, generator)
    found = encoder.read(shown)[-1][hidden]
    return F.cross_entropy(found @ encoder.words.weight.t(), text.tokens[hidden])
