"""What the latent of an `act_chunked` policy has to do with the ways: posterior, prior, decoder."""

import numpy as np
from jaxtyping import Float, Int64

from lerobot_act_chunking.diagnostics.core.latents.encoding import decode, encode, reconstruct
from lerobot_act_chunking.diagnostics.core.latents.subject import Subject
from lerobot_act_chunking.diagnostics.core.samples import Samples
from lerobot_act_chunking.diagnostics.modes.demonstrated import Demonstrated
from lerobot_act_chunking.diagnostics.modes.frequencies import Frequencies
from lerobot_act_chunking.diagnostics.modes.inside import LatentModes
from lerobot_act_chunking.nn.latents.health import ACTIVE_VARIANCE

REPEATS = 4  # samples of the prior and of the aggregated posterior for each start


def measure_latent(
    subject: Subject,
    starts: Samples,
    demonstrated: Demonstrated,
    modes: Int64[np.ndarray, " N"],
    proportions: tuple[float, ...],
    *,
    seed: int,
) -> LatentModes:
    """Decode styles from everywhere, and see which ways they go.

    Args:
        subject: the policy.
        starts: first frames of N demonstrations.
        demonstrated: all demonstrations.
        modes: the way of each of the N.
        proportions: of the ways.
        seed: of posteriors, priors, and whose style is shown to whom.
    """
    encoded = [encode(subject, starts, seed=seed + repeat) for repeat in range(REPEATS)]
    rng = np.random.default_rng(seed)
    styles = {"own": encoded[0].z, "mode": encoded[0].mode}
    for repeat, each in enumerate(encoded):
        styles |= {f"prior {repeat}": each.prior, f"posterior {repeat}": each.z[rng.permutation(len(each.z))]}
    decoded = decode(subject, starts, styles, seed=seed)
    reference = demonstrated.reference(0, decoded["own"].shape[1])
    ways = {name: reference.classify(demonstrated.scaled(each)) for name, each in decoded.items()}
    errors = reconstruct(subject, starts, {"own": encoded[0].z}, seed=seed).errors["own"]

    def taken(kind: str) -> Frequencies:
        return Frequencies.of(np.concatenate([ways[f"{kind} {i}"] for i in range(REPEATS)]), proportions)

    return LatentModes(
        kl=float(encoded[0].divergence.mean(0).sum()),
        active_units=int((encoded[0].mean.var(0) > ACTIVE_VARIANCE).sum()),
        errors=_by_mode(errors, modes, len(proportions)),
        reconstructed=_by_mode((ways["own"] == modes).astype(float), modes, len(proportions)),
        prior=taken("prior"),
        posterior=taken("posterior"),
        likeliest=Frequencies.of(ways["mode"], proportions),
        fitted=bool(getattr(subject.latent, "fitted", False)),
    )


def _by_mode(values: Float[np.ndarray, " N"], modes: Int64[np.ndarray, " N"], n: int) -> list[float | None]:
    """Means by mode; None of those without a value."""
    parts = [values[modes == mode] for mode in range(n)]
    return [float(each.mean()) if each.size else None for each in parts]
