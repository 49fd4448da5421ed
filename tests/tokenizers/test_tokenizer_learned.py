"""What learned tokenizers promise."""

import pytest
import torch
from tokenizer_cases import (
    LEARNED,
    A,
    C,
    D,
    G,
    N,
    chunks,
    gradients,
    no_padding,
    same,
    small,
    spec,
    state,
)

from lerobot_act_chunking.data.masking import hold_padding
from lerobot_act_chunking.tokenizers.learned import COMMITMENT, perplexity
from lerobot_act_chunking.tokenizers.make import make_tokenizer

CODERS = ("mlp", "conv")


def padding():
    """A batch of which chunk 3 is mostly padding and chunk 5 has some."""
    is_pad = no_padding()
    is_pad[3, 3:] = True
    is_pad[5, 4:] = True
    return is_pad


def taught(tokenizer, batches=3):
    for seed in range(batches):
        tokenizer.learn(chunks(seed=seed), no_padding(), seed)
    return tokenizer


@pytest.mark.parametrize("coder", CODERS)
@pytest.mark.parametrize(
    "settings",
    [{"rotation_trick": True}, {"rotation_trick": False}, {"tokenizer": "fsq", "fsq_levels": (5, 5)}],
)
def test_learning_reconstructs(settings, coder):
    tokenizer = small(**settings, vqvae_n_embed=16, vqvae_coder=coder, dead_code_threshold=0.5)
    optimizer = torch.optim.AdamW(tokenizer.parameters(), lr=1e-2)
    batch, errors = chunks(), []
    for seed in range(60):
        learned = tokenizer.learn(batch, no_padding(), seed)
        optimizer.zero_grad()
        learned.loss.mean().backward()
        optimizer.step()
        errors.append(learned.metrics["reconstruction_l1"])
    assert min(errors[-5:]) < 0.75 * errors[0]
    assert len(tokenizer.encode(batch).unique(dim=0)) > 3


@pytest.mark.parametrize("coder", CODERS)
@pytest.mark.parametrize("chunk_size", [1, 2, 3, 4, 5, 8, 13])
def test_coders_take_every_length(coder, chunk_size):
    tokenizer = make_tokenizer(spec(vqvae_coder=coder, chunk_size=chunk_size))
    actions = torch.randn(11, chunk_size, A)
    assert tokenizer.encoder(actions).shape == (11, D)
    assert tokenizer(actions).shape == actions.shape


@pytest.mark.parametrize("name", LEARNED)
def test_every_weight_learns(name):
    tokenizer = small(name, kmeans_iters=0)
    tokenizer.learn(chunks(), no_padding(), 0).loss.mean().backward()
    assert all(gradient.abs().sum() > 0 for gradient in gradients(tokenizer).values())


@pytest.mark.parametrize("name", LEARNED)
def test_codes_are_what_learning_quantises_by(name):
    tokenizer = taught(small(name)).eval()
    learned = tokenizer.learn(chunks(), no_padding(), 0)
    codes = tokenizer.encode(chunks())
    assert torch.equal(learned.codes, codes)
    torch.testing.assert_close(tokenizer.decode(codes), learned.actions, rtol=1e-5, atol=1e-6)
    assert codes.shape == (N, G)
    assert 0 <= codes.min() <= codes.max() < tokenizer.vocabulary


@pytest.mark.parametrize("name", LEARNED)
def test_only_learning_in_training_changes_a_tokenizer(name):
    for tokenizer in (small(name), taught(small(name))):
        before = state(tokenizer)
        for mode in (True, False):
            tokenizer.train(mode)
            assert not tokenizer.encode(chunks()).requires_grad
            tokenizer(chunks(seed=2))
            tokenizer.reconstruction_error(chunks(seed=3), no_padding())
        tokenizer.eval().learn(chunks(), no_padding(), 0)
        assert same(before, state(tokenizer))


def test_a_fresh_codebook_has_one_code_until_the_first_batch_places_them():
    tokenizer = small()
    assert tokenizer.encode(chunks()).eq(0).all()
    assert tokenizer.eval().learn(chunks(), no_padding(), 0).metrics["commitment"] == 0
    tokenizer.train().learn(chunks(), no_padding(), 0)
    assert len(tokenizer.encode(chunks()).unique(dim=0)) > 1


def test_validation_has_the_same_loss_as_training():
    tokenizer = taught(small())
    validated = tokenizer.eval().learn(chunks(), padding(), 0)
    learned = tokenizer.train().learn(chunks(), padding(), 0)
    assert torch.equal(validated.loss, learned.loss)
    assert validated.metrics == learned.metrics
    assert learned.metrics["commitment"] > 0


def test_the_loss_has_the_commitment_five_times():
    tokenizer = taught(small())
    learned = tokenizer.learn(chunks(), no_padding(), 0)
    found = learned.loss.mean().item() - learned.metrics["reconstruction_l1"]
    assert found == pytest.approx(COMMITMENT * learned.metrics["commitment"], rel=1e-4)


def test_k_means_places_codes_by_the_seed():
    def first(seed, global_seed):
        tokenizer = small(seed=0)
        torch.manual_seed(global_seed)
        tokenizer.learn(chunks(), no_padding(), seed)
        return state(tokenizer)

    assert same(first(4, 0), first(4, 1))
    assert not same(first(4, 0), first(5, 0))


def test_learning_leaves_the_global_generator_alone():
    tokenizer = small(dead_code_threshold=100.0)
    torch.manual_seed(7)
    before = torch.get_rng_state()
    taught(tokenizer)
    assert torch.equal(before, torch.get_rng_state())


@pytest.mark.parametrize(("threshold", "revived"), [(0.5, True), (0.0, False)])
def test_dead_codes_are_placed_anew(threshold, revived):
    tokenizer = taught(small(vqvae_num_layers=1, dead_code_threshold=threshold))
    codebook = tokenizer.quantizer.levels.layers[0]._codebook
    codebook.cluster_size[0, 2] = 0.0
    codebook.embed[0, 2] = codebook.embed_avg[0, 2] = 50.0
    batch = chunks()
    tokenizer.learn(batch, no_padding(), 0)
    distance = (tokenizer.encoder(batch) - codebook.embed[0, 2]).norm(dim=-1).min().item()
    assert (distance < 1e-4) == revived


def test_in_a_small_batch_codes_in_use_stay():
    tokenizer = taught(small(vqvae_num_layers=1, vqvae_n_embed=16, dead_code_threshold=0.25))
    codebook = tokenizer.quantizer.levels.layers[0]._codebook
    codebook.cluster_size.fill_(0.5)  # eight encodings a batch, evenly used
    codebook.embed_avg.copy_(0.5 * codebook.embed)
    before = codebook.embed.clone()
    batch = chunks()[:8]
    tokenizer.learn(batch, no_padding()[:8], 0)
    unused = torch.ones(16, dtype=torch.bool)
    unused[tokenizer.encode(batch)[:, 0]] = False
    assert unused.any()
    torch.testing.assert_close(codebook.embed[0, unused], before[0, unused], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", LEARNED)
def test_what_stands_in_the_padding_does_not_matter(name):
    learned = []
    for filler in (0.0, 99.0):
        tokenizer = small(name)
        batch = hold_padding(torch.where(padding()[..., None], filler, chunks()), padding())
        loss = tokenizer.learn(batch, padding(), 0).loss
        loss.mean().backward()
        learned.append((loss, state(tokenizer), gradients(tokenizer)))
    assert torch.equal(learned[0][0], learned[1][0])
    assert same(learned[0][1], learned[1][1])
    assert same(learned[0][2], learned[1][2])


@pytest.mark.parametrize("name", LEARNED)
def test_chunks_that_are_mostly_padding_teach_nothing(name):
    learned = []
    for n_extra in (0, 4):
        tokenizer = small(name, dead_code_threshold=1.0)
        batch = torch.cat((chunks(), chunks(4, seed=9)[:n_extra] + 5))
        is_pad = torch.cat((padding() & (torch.arange(N) != 3)[:, None], no_padding(n_extra)))
        is_pad[N:, 3:] = True
        reconstruction = tokenizer.learn(hold_padding(batch, is_pad), is_pad, 0)
        reconstruction.loss.mean().backward()
        assert reconstruction.loss[N:].eq(0).all()
        learned.append((reconstruction, state(tokenizer), gradients(tokenizer)))
    (without, state_without, gradients_without), (with_them, state_with, gradients_with) = learned
    torch.testing.assert_close(without.loss.mean(), with_them.loss.mean())
    assert without.metrics == pytest.approx(with_them.metrics, rel=1e-5)
    for found, expected in ((state_with, state_without), (gradients_with, gradients_without)):
        for key in expected:
            torch.testing.assert_close(found[key], expected[key], rtol=1e-4, atol=1e-6)


def test_losses_by_chunk_average_to_the_mean_over_valid_steps():
    tokenizer = small("fsq")
    is_pad = padding()
    learned = tokenizer.learn(hold_padding(chunks(), is_pad), is_pad, 0)
    counts = ~is_pad
    counts[3] = False
    errors = (learned.actions - chunks()).abs()[counts]
    torch.testing.assert_close(learned.loss.mean(), errors.mean())
    share = errors.numel() / N
    torch.testing.assert_close(learned.loss[5], (learned.actions - chunks()).abs()[5, :4].sum() / share)


@pytest.mark.parametrize(("n_padded", "teaches"), [(4, True), (5, False)])
def test_half_a_chunk_is_enough_to_teach(n_padded, teaches):
    tokenizer = small("fsq", chunk_size=8)
    is_pad = torch.zeros(2, 8, dtype=torch.bool)
    is_pad[0, 8 - n_padded :] = True
    loss = tokenizer.learn(torch.randn(2, 8, A), is_pad, 0).loss
    assert (loss[0] > 0) == teaches


@pytest.mark.parametrize("name", LEARNED)
def test_a_batch_of_padding_changes_nothing(name):
    tokenizer = taught(small(name))
    before = state(tokenizer)
    learned = tokenizer.learn(chunks(), ~no_padding(), 0)
    learned.loss.mean().backward()
    assert learned.loss.eq(0).all()
    assert same(before, state(tokenizer))
    assert all(gradient.eq(0).all() for gradient in gradients(tokenizer).values())
    assert learned.metrics == {"reconstruction_l1": 0, "commitment": 0, "used_codes": 0, "code_perplexity": 1}


@pytest.mark.parametrize("name", LEARNED)
@pytest.mark.parametrize("coder", CODERS)
def test_autocast_changes_no_code(name, coder):
    learned = []
    for enabled in (False, True):
        tokenizer = small(name, vqvae_coder=coder)
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=enabled):
            loss = tokenizer.learn(chunks(), padding(), 0).loss
            codes = tokenizer.encode(chunks())
            decoded = tokenizer.decode(codes)
        loss.mean().backward()
        learned.append((loss, codes, decoded, gradients(tokenizer)))
    for found, expected in zip(learned[1][:3], learned[0][:3], strict=True):
        assert torch.equal(found, expected)
    assert same(learned[1][3], learned[0][3])


@pytest.mark.parametrize("name", LEARNED)
def test_codes_survive_a_state_dict(name):
    first, second = taught(small(name, seed=0)), small(name, seed=1)
    second.load_state_dict(first.state_dict())
    codes = first.encode(chunks())
    assert torch.equal(second.encode(chunks()), codes)
    assert torch.equal(second.decode(codes), first.decode(codes))
    taught(first)
    taught(second)
    assert same(state(first), state(second))


def test_decoding_is_differentiable_in_the_decoder_alone():
    tokenizer = taught(small())
    tokenizer.decode(tokenizer.encode(chunks())).sum().backward()
    with_gradient = {
        name.split(".")[0] for name, weight in tokenizer.named_parameters() if weight.grad is not None
    }
    assert with_gradient == {"decoder"}


def test_reconstruction_error_by_dimension():
    tokenizer = taught(small())
    is_pad = padding()
    expected = (tokenizer(chunks()) - chunks()).abs()[~is_pad].mean(0)
    torch.testing.assert_close(tokenizer.reconstruction_error(chunks(), is_pad), expected)


def test_perplexity_counts_equally_frequent_codes():
    codes = torch.tensor([[0, 1], [1, 1], [2, 1], [3, 1]])
    assert perplexity(codes, 6).tolist() == pytest.approx([4.0, 1.0])


def test_fsq_has_as_many_codes_as_values_combine_to():
    tokenizer = small("fsq", fsq_levels=(3, 5, 2))
    assert (tokenizer.vocabulary, tokenizer.n_codes) == (30, G)
    every = torch.arange(30)[:, None].expand(-1, G)
    vectors = tokenizer.quantizer.vectors(every)
    assert len(vectors.unique(dim=0)) == 30


def test_a_process_group_moves_codebooks_as_one_process_does(tmp_path):
    alone = taught(small(kmeans_iters=0, dead_code_threshold=0.0))
    torch.distributed.init_process_group("gloo", init_method=f"file://{tmp_path}/group", rank=0, world_size=1)
    try:
        together = taught(small(kmeans_iters=0, dead_code_threshold=0.0))
        placed = taught(small(dead_code_threshold=100.0))
        before = state(together)
        together.learn(chunks(), ~no_padding(), 0)
    finally:
        torch.distributed.destroy_process_group()
    assert same(state(alone), state(together))
    assert same(before, state(together))
    assert placed.quantizer.is_placed


def test_the_length_is_the_time_axis():
    tokenizer = small(vqvae_coder="conv")
    assert tokenizer.encoder.layers[0].in_channels == A
    assert tokenizer(torch.randn(2, C, A)).shape == (2, C, A)
