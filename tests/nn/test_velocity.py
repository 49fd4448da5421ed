import pytest
import torch

from lerobot_act_chunking.nn.velocity import BATCHES_MEASURED, LEAST_SCALE, FiniteDifferences

B, H = 64, 3
DIMS = {"state": 4, "object": 2}
SPEED = torch.tensor([0.5, 3.0, 0.2, 10.0])  # of each state dimension [raw units per step]


def raw_states(seed=0, n=B):
    """Positions far from zero, whose changes are of the size ``SPEED``."""
    generator = torch.Generator().manual_seed(seed)
    start = 5 + torch.randn(n, 1, 4, generator=generator, dtype=torch.float64)
    changes = SPEED * torch.randn(n, H - 1, 4, generator=generator, dtype=torch.float64)
    return torch.cat((start, start + changes.cumsum(1)), dim=1)


def normalised(raw, mean, std):
    return ((raw - mean) / std).float()


def window(raw, mean=5.0, std=20.0):
    objects = torch.linspace(-1, 1, raw.shape[0] * H * 2).reshape(-1, H, 2).square()
    return {"object": objects, "unused": raw.float(), "state": normalised(raw, mean, std)}


@pytest.fixture
def measured():
    differences = FiniteDifferences(DIMS)
    differences(window(raw_states()))
    return differences.eval()


def test_velocities_are_right_in_raw_units(measured):
    raw = raw_states(seed=1)
    out = measured(window(raw))
    assert {key: value.shape for key, value in out.items()} == {
        "state": (B, H - 1, 4),
        "object": (B, H - 1, 2),
    }
    in_raw_units = out["state"] * measured.scale[:4] * 20.0
    torch.testing.assert_close(in_raw_units.double(), raw[:, 1:] - raw[:, :-1], rtol=1e-3, atol=1e-4)


def test_each_key_has_its_own_scale(measured):
    inputs = window(raw_states())
    torch.testing.assert_close(
        measured(inputs)["object"] * measured.scale[4:], inputs["object"][:, 1:] - inputs["object"][:, :-1]
    )


def test_normalisation_cancels():
    """The same motion is the same velocity, whatever the statistics of the dataset are."""
    raw, results = raw_states(), []
    for mean, std in (
        (5.0, 20.0),
        (torch.tensor([1.0, -3.0, 5.0, 0.0]), torch.tensor([2.0, 50.0, 0.5, 90.0])),
    ):
        differences = FiniteDifferences(DIMS)
        results.append(differences(window(raw, mean, std))["state"])
    torch.testing.assert_close(*results, rtol=1e-3, atol=1e-3)


def test_usual_velocities_have_size_one():
    differences = FiniteDifferences(DIMS)
    out = differences(window(raw_states()))["state"]
    torch.testing.assert_close(out.square().mean((0, 1)), torch.ones(4))


def test_an_episode_starts_at_rest(measured):
    """Its first observation stands in for those before."""
    inputs = {key: value[:, :1].expand(-1, H, -1) for key, value in window(raw_states()).items()}
    assert all((value == 0).all() for value in measured(inputs).values())


def test_the_first_batches_count_alike_and_then_no_more():
    differences, batches = FiniteDifferences(DIMS), [window(raw_states(seed)) for seed in range(3)]
    for inputs in batches:
        differences(inputs)
    squares = torch.stack([inputs["state"].diff(dim=1).square().mean((0, 1)) for inputs in batches])
    torch.testing.assert_close(differences.mean_square[:4], squares.mean(0))
    for _ in range(BATCHES_MEASURED - 3):
        differences(batches[0])
    kept = differences.mean_square.clone()
    differences(window(100 * raw_states(9)))
    assert torch.equal(differences.mean_square, kept)
    assert differences.n_batches == BATCHES_MEASURED


def test_acting_measures_nothing(measured):
    before = {key: value.clone() for key, value in measured.state_dict().items()}
    measured(window(100 * raw_states(9)))
    assert before.keys() == {"mean_square", "n_batches"}
    assert all(torch.equal(value, before[key]) for key, value in measured.state_dict().items())


def test_the_scale_is_saved_with_the_weights(measured):
    loaded, inputs = FiniteDifferences(DIMS).eval(), window(raw_states(2))
    assert not torch.equal(loaded(inputs)["state"], measured(inputs)["state"])
    loaded.load_state_dict(measured.state_dict())
    assert torch.equal(loaded(inputs)["state"], measured(inputs)["state"])


def test_the_noise_of_what_rests_is_not_blown_up():
    noise = 1e-7 * torch.randn(B, H, 4, generator=torch.Generator().manual_seed(0))
    out = FiniteDifferences({"state": 4})({"state": noise})["state"]
    torch.testing.assert_close(out, noise.diff(dim=1) / LEAST_SCALE)
