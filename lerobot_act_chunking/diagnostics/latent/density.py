"""A mixture of normal distributions that follows the encoded demonstrations."""

import warnings
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int64

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.nn.latents.gaussian import MOST_COMPONENTS, GaussianLatent

COMPONENTS = (1, 2, 3, 4, 6, 8, 12, MOST_COMPONENTS)
MOST_SAMPLES = 5000  # on which candidates are fitted
PATIENCE = 2  # larger candidates in a row that are no better, after which none is tried


@dataclass(frozen=True)
class Density:
    """A mixture.

    Attributes:
        weights: (M,) shares.
        means: (M, L).
        scales: (M, L, L) lower triangular factors of the covariances.
        covariance: ``full`` or ``diag``.
        bic: Bayesian information criterion by number of components, of that kind; the least is chosen.
    """

    weights: Float[np.ndarray, " M"]
    means: Float[np.ndarray, "M L"]
    scales: Float[np.ndarray, "M L L"]
    covariance: str
    bic: dict[int, float]

    def assign(self, z: Float[np.ndarray, "N L"]) -> Int64[np.ndarray, " N"]:
        """The component that each style most likely comes from."""
        from scipy.linalg import solve_triangular

        scores = [
            np.log(weight)
            - np.log(np.diag(scale)).sum()
            - 0.5 * np.square(solve_triangular(scale, (z - mean).T, lower=True)).sum(0)
            for weight, mean, scale in zip(self.weights, self.means, self.scales, strict=True)
        ]
        return np.argmax(scores, axis=0)


def fit_density(z: Float[np.ndarray, "N L"], *, seed: int) -> Density:
    """Fit mixtures of several sizes and take the one with the least BIC (Schwarz 1978).

    Args:
        z: one sample of each demonstration's posterior, so that the mixture also has the posteriors' width
            (ex-post density estimation, Ghosh et al. 2020, section 4, for a variational encoder).
        seed: of the k-means that places components, and of the choice of samples if there are many.

    Raises:
        DatasetError: fewer samples than a mixture takes.
    """
    least = 2 * (z.shape[1] + 1)
    if len(z) < least:
        raise DatasetError(
            f"{len(z)} encoded demonstrations are too few for a density over {z.shape[1]} dimensions: "
            f"{least} are needed"
        )
    kept = np.random.default_rng(seed).permutation(len(z))[:MOST_SAMPLES]
    candidates = [_best(z[kept], kind, seed) for kind in ("full", "diag")]
    return min(candidates, key=lambda density: min(density.bic.values()))


def _best(z: Float[np.ndarray, "N L"], kind: str, seed: int) -> Density:
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.mixture import GaussianMixture

    fits, bic = {}, {}
    for n in COMPONENTS:
        if n * (z.shape[1] + 1) > len(z) or _stalled(bic):
            break
        with warnings.catch_warnings():
            # One that has not converged is as good a candidate as its likelihood.
            warnings.simplefilter("ignore", ConvergenceWarning)
            fits[n] = GaussianMixture(n, covariance_type=kind, random_state=seed, max_iter=200).fit(z)  # pyright: ignore[reportArgumentType]
        bic[n] = float(fits[n].bic(z))
    chosen = fits[min(bic, key=bic.__getitem__)]
    covariances = np.asarray(chosen.covariances_)
    if kind == "diag":
        covariances = covariances[:, :, None] * np.eye(z.shape[1])
    return Density(chosen.weights_, chosen.means_, np.linalg.cholesky(covariances), kind, bic)


def _stalled(bic: dict[int, float]) -> bool:
    values = list(bic.values())
    return len(values) > PATIENCE and min(values[-PATIENCE:]) > min(values[:-PATIENCE])


def with_density(latent: GaussianLatent, density: Density) -> GaussianLatent:
    """A latent like this one that samples from the density."""
    fitted = GaussianLatent(latent.dim, temperature=latent.temperature, uniform=latent.uniform)
    fitted.fit_density(
        *(torch.from_numpy(each).float() for each in (density.weights, density.means, density.scales))
    )
    return fitted
