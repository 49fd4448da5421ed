"""Instructions as vectors."""

import pytest
import torch

from lerobot_act_chunking.nn.instruction import READERS, InstructionEmbedding, MeanReader, embeddings

N, LONGEST, WIDTH = 4, 6, 16
LENGTHS = torch.tensor([6, 3, 4, 2])


@pytest.fixture
def said():
    generator = torch.Generator().manual_seed(0)
    states = torch.randn(N, LONGEST, WIDTH, generator=generator)
    return states, torch.arange(LONGEST) < LENGTHS[:, None]


@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
def test_what_fills_up_shorter_instructions_is_not_read(reader, said):
    torch.manual_seed(0)
    states, mask = said
    read = reader(WIDTH)
    other = torch.where(mask[..., None], states, 100.0)
    torch.testing.assert_close(read(states, mask), read(other, mask))
    torch.testing.assert_close(read(states[3:, :2], mask[3:, :2]), read(states, mask)[3:])
    assert read(states, mask).shape == (N, read.dim)


def test_embeddings_are_means_of_length_one(said):
    states, mask = said
    expected = torch.nn.functional.normalize(states[1, :3].mean(0), dim=0)
    torch.testing.assert_close(embeddings(states, mask)[1], expected)


def test_the_mean_reader_standardises_what_training_says(said):
    states, mask = said
    reader = MeanReader(WIDTH)
    reader.fit(states, mask)
    read = reader(states, mask)
    torch.testing.assert_close(read.mean(0), torch.zeros(WIDTH), atol=1e-5, rtol=0)
    torch.testing.assert_close(read.square().mean(), torch.tensor(1.0))
    spread = reader.spread.clone()
    reader.fit(states[:1], mask[:1])
    assert reader.spread == spread


def test_samples_get_their_instruction_or_the_learned_stand_in(said):
    torch.manual_seed(0)
    states, mask = said
    embed = InstructionEmbedding(READERS["words"](WIDTH), with_null=True)
    rows, drop = torch.tensor([2, 0, 2]), torch.tensor([False, False, True])
    vectors = embed(states, mask, rows, drop)
    read = embed.reader(states, mask)
    torch.testing.assert_close(vectors, torch.stack([read[2], read[0], embed.null]))
    torch.testing.assert_close(embed(states, mask, rows), read[rows])
