import numpy as np
import pytest

from lerobot_act_chunking.diagnostics.core.latents.encoding import Encoded
from lerobot_act_chunking.diagnostics.core.samples import Samples
from lerobot_act_chunking.diagnostics.latent.density import fit_density
from lerobot_act_chunking.diagnostics.latent.figures import (
    check_prior,
    measure_groups,
    measure_health,
    share_outside,
)
from lerobot_act_chunking.errors import DatasetError

N, L = 600, 3
RNG = np.random.default_rng(0)
CENTRES = np.array([[4.0, 0, 0], [-4.0, 1, 0]])
OF = np.arange(N) % 10 // 9  # nine in ten around the first centre


def styles(seed=0, n=N):
    """Two clusters in the first two dimensions; the third is noise."""
    noise = np.random.default_rng(seed).normal(size=(n, L)) * [0.5, 0.5, 1.0]
    return CENTRES[np.arange(n) % 10 // 9] + noise


def encoded(z=None):
    z = styles() if z is None else z
    mean = z * [1, 1, 0]
    divergence = np.tile([2.0, 0.5, 0.001], (len(z), 1))
    return Encoded(mean=mean, divergence=divergence, z=z, prior=z, mode=0 * z)


def samples(n=N):
    return Samples("data", None, np.arange(n), np.arange(n) // 60, np.zeros(n))


def test_health():
    health = measure_health(encoded(), np.linspace(0, 1, N))
    assert health.kl == pytest.approx(2.501)
    assert health.kl_by_dimension == pytest.approx([2.0, 0.5, 0.001])
    assert (health.kl_active_dims, health.active_units) == (2, 2)


def test_styles_that_follow_the_place_in_the_episode():
    place = np.random.default_rng(3).permutation(np.tile(np.linspace(0, 1, 60), 10))
    apart = measure_health(encoded(), place).by_place
    same = np.stack([place, np.sin(3 * place), 0 * place], axis=1)
    assert apart < 0.1
    assert measure_health(encoded(same), place).by_place > 0.95


def test_styles_like_the_demonstrated_are_not_outside():
    assert share_outside(styles(1), encoded(), samples().episode) < 0.03


def test_styles_between_the_demonstrated_are_outside():
    drawn = styles(1)
    drawn[:150] = np.random.default_rng(2).normal(size=(150, L)) * 0.3
    assert share_outside(drawn, encoded(), samples().episode) == pytest.approx(0.25, abs=0.03)


def test_inactive_dimensions_do_not_count():
    drawn = styles(1)
    drawn[:, 2] += 100
    assert share_outside(drawn, encoded(), samples().episode) < 0.03


def test_a_single_episode_is_halved():
    assert share_outside(styles(1), encoded(), np.zeros(N, int)) < 0.03


def test_nothing_is_outside_of_a_collapsed_latent():
    z = RNG.normal(size=(N, L))
    collapsed = Encoded(mean=0 * z, divergence=0 * z, z=z, prior=z, mode=0 * z)
    assert share_outside(9 + z, collapsed, samples().episode) == 0.0


def test_groups_that_a_prior_hardly_samples_are_starved():
    of_prior = np.zeros(N, int)
    of_prior[:10] = 1  # 1.7 % where demonstrations have 10 %
    check = check_prior("p", styles(1), encoded(), samples(), (OF, of_prior, 2))
    assert check.starved == pytest.approx(0.1)
    assert check.groups == pytest.approx([590 / 600, 10 / 600])
    of_prior[:20] = 1  # 3.3 %: a third as often
    assert check_prior("p", styles(1), encoded(), samples(), (OF, of_prior, 2)).starved == 0.0


def test_groups_too_small_to_judge_do_not_starve():
    of = np.zeros(N, int)
    of[:5] = 1
    assert check_prior("p", styles(1), encoded(), samples(), (of, np.zeros(N, int), 2)).starved == 0.0


def test_errors_by_group():
    groups = measure_groups(OF, 3, np.array([0, 1, 0]), np.array([0.1, 0.7, 0.3]))
    assert [group.share for group in groups] == pytest.approx([0.9, 0.1, 0.0])
    assert [group.error for group in groups] == [pytest.approx(0.2), pytest.approx(0.7), None]


def test_a_density_finds_the_clusters_and_their_shape():
    density = fit_density(styles(n=1000), seed=0)
    assert len(density.weights) == 2
    first = density.weights.argmax()
    assert density.weights[first] == pytest.approx(0.9)
    np.testing.assert_allclose(density.means[[first, 1 - first]], CENTRES, atol=0.2)
    covariance = density.scales[first] @ density.scales[first].T
    np.testing.assert_allclose(covariance, np.diag([0.25, 0.25, 1.0]), atol=0.1)
    assert np.array_equal(density.scales, np.tril(density.scales))
    of = np.arange(1000) % 10 // 9
    assert (density.assign(styles(1, 1000)) == np.where(of == 0, first, 1 - first)).all()


def test_a_density_that_leans_keeps_its_correlations():
    z = np.random.default_rng(0).normal(size=(N, 2)) @ np.array([[1.0, 0.9], [0.0, 0.4]])
    density = fit_density(z, seed=0)
    assert density.covariance == "full"
    assert len(density.weights) == 1
    np.testing.assert_allclose(density.scales[0] @ density.scales[0].T, np.cov(z.T), atol=0.02)


def test_too_few_demonstrations_for_a_density():
    with pytest.raises(DatasetError, match="7 encoded demonstrations are too few for a density over 3 dim"):
        fit_density(styles(n=7), seed=0)


def test_styles_are_far_in_units_of_each_dimension():
    """What is outside does not change with the units of a dimension."""
    rng = np.random.default_rng(0)
    z, drawn = rng.normal(size=(600, 2)), rng.normal(size=(400, 2))
    drawn[:100, 1] += 8  # outside, in the dimension that the second case shrinks
    episode = np.arange(600) // 60
    shares = []
    for units in ([1.0, 1.0], [50.0, 0.5]):
        mean = z * units
        encoded = Encoded(mean=mean, divergence=np.ones((600, 2)), z=mean, prior=mean, mode=0 * mean)
        shares.append(share_outside(drawn * units, encoded, episode))
    assert shares[0] == pytest.approx(shares[1])
    assert shares[0] == pytest.approx(0.25, abs=0.05)
