"""Our use of the library is the loss and update of Lee et al. 2024 (VQ-BeT), and LeRobot's."""

import copy

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.vqbet.configuration_vqbet import VQBeTConfig
from lerobot.policies.vqbet.modeling_vqbet import VqVae
from reference_rvq import ReferenceRvq
from tokenizer_cases import A, C, D, M, chunks, gradients, no_padding, small

DECAY, BETA, UPDATES = 0.9, 0.25, 6
PLAIN = {"kmeans_iters": 0, "dead_code_threshold": 0.0, "rotation_trick": False}


def codebooks(tokenizer):
    return tokenizer.quantizer.levels.codebooks


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_learning_equals_the_reference(levels):
    ours = small(**PLAIN, vqvae_num_layers=levels, vqvae_decay=DECAY, commitment_weight=BETA)
    ours.encoder[1][-1].weight.data *= 20  # encodings far enough apart for several codes
    encoder, decoder = copy.deepcopy(ours.encoder), copy.deepcopy(ours.decoder)
    reference = ReferenceRvq(codebooks(ours), decay=DECAY, beta=BETA)
    theirs = [*encoder.parameters(), *decoder.parameters()]
    mine = [*ours.encoder.parameters(), *ours.decoder.parameters()]
    first = torch.optim.SGD(mine, lr=1e-3)
    second = torch.optim.SGD(theirs, lr=1e-3)
    seen = []
    for update in range(UPDATES):
        batch = chunks(seed=update)
        learned = ours.learn(batch, no_padding(), seed=update)
        vectors, codes, commitment = reference.quantize(encoder(batch))
        expected = (decoder(vectors) - batch).abs().mean() + 5 * commitment
        assert torch.equal(learned.codes, codes)
        seen.append(codes)
        torch.testing.assert_close(learned.loss.mean(), expected, rtol=1e-5, atol=1e-6)
        torch.testing.assert_close(codebooks(ours), torch.stack(reference.codebooks), rtol=1e-5, atol=1e-6)
        for optimizer, loss in ((first, learned.loss.mean()), (second, expected)):
            optimizer.zero_grad()
            loss.backward()
        for our_weight, their_weight in zip(mine, theirs, strict=True):
            torch.testing.assert_close(our_weight.grad, their_weight.grad, rtol=1e-4, atol=1e-6)
        first.step()
        second.step()
    assert len(torch.cat(seen).unique(dim=0)) > 3


def test_codes_settle_on_the_means_of_what_they_stand_for():
    ours = small(**PLAIN, vqvae_num_layers=1, vqvae_decay=0.5)
    batch = chunks()
    for update in range(60):
        learned = ours.learn(batch, no_padding(), seed=update)
    encodings = ours.encoder(batch).detach()
    for code in learned.codes.unique():
        mean = encodings[learned.codes[:, 0] == code].mean(0)
        torch.testing.assert_close(codebooks(ours)[0, code], mean, rtol=1e-3, atol=1e-3)


def lerobot_vqvae():
    config = VQBeTConfig(
        action_chunk_size=C,
        vqvae_n_embed=M,
        vqvae_embedding_dim=D,
        vqvae_enc_hidden_dim=16,
        output_features={"action": PolicyFeature(FeatureType.ACTION, (A,))},
    )
    torch.manual_seed(3)
    return VqVae(config)


def test_lerobots_vqvae_by_weight_map():
    theirs = lerobot_vqvae()
    ours = small(**PLAIN, vqvae_decay=0.8, commitment_weight=1.0)
    mapped = {}
    for name, value in theirs.state_dict().items():
        coder, _, rest = name.partition(".")
        if coder == "vq_layer" and rest != "freeze_codebook":
            mapped[f"quantizer.levels.{rest}"] = value
        elif coder in ("encoder", "decoder"):
            mapped[f"{coder}.{'1' if coder == 'encoder' else '0'}.{rest}"] = value
    for name, value in ours.state_dict().items():
        mapped[name] = mapped[name].reshape(value.shape)
    ours.load_state_dict(mapped, strict=True)
    for update in range(3):
        batch = chunks(seed=update)
        loss, (l1, commitment, codes, _) = theirs.vqvae_forward(batch)
        learned = ours.learn(batch, no_padding(), seed=0)
        assert torch.equal(learned.codes, codes)
        torch.testing.assert_close(learned.loss.mean(), loss, rtol=1e-5, atol=1e-6)
        assert learned.metrics["reconstruction_l1"] == pytest.approx(l1.item(), rel=1e-5)
        assert learned.metrics["commitment"] == pytest.approx(commitment.item(), rel=1e-5)
    theirs.zero_grad()
    loss.backward()
    learned.loss.mean().backward()
    found = gradients(ours)
    for name, weight in theirs.named_parameters():
        place = name.replace("encoder", "encoder.1").replace("decoder", "decoder.0")
        torch.testing.assert_close(found[place], weight.grad, rtol=1e-4, atol=1e-6)
    theirs.eval()
    ours.eval()
    codes = theirs.get_code(batch)[1]
    assert torch.equal(ours.encode(batch), codes)
    expected = theirs.get_action_from_latent(theirs.get_embeddings_from_code(codes))
    torch.testing.assert_close(ours.decode(codes), expected, rtol=1e-5, atol=1e-6)
