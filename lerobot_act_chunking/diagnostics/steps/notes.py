"""What to know about a sweep, in sentences."""

from collections.abc import Callable

from lerobot_act_chunking.diagnostics.steps import plateau
from lerobot_act_chunking.diagnostics.steps.grid import Cell
from lerobot_act_chunking.diagnostics.steps.results import Sweep
from lerobot_act_chunking.diagnostics.steps.sources import HeldOut
from lerobot_act_chunking.diagnostics.steps.verdict import StepsJudgement

TOO_WIDE = (
    "What helps a model that spreads: more training or demonstrations of the contact, a demonstrator who "
    "repeats it more exactly, an observation that shows what decides there."
)
NOT_CONVERGING = (
    "The network answers differently at neighbouring noise levels, and the last ones it is asked at, which "
    "depend on the number of steps, decide. More training makes its answers agree; their distance to the "
    "demonstrations says which steps to use meanwhile."
)
SEEN = "The policy was trained on these episodes: its distance to the demonstrations is flattering."
ONE_MODE = "Samples for one observation form one mode: there are no mode flips to leave out."
SEVERAL_MODES = (
    "{share} of the observations have several modes. Pairs that end in different ones are counted as flips, "
    "not as errors; few steps starve rare modes."
)
FEWEST_NEAR_CONTACT = 30
FEW_NEAR_CONTACT = "Only {n} of the observations are near contact: what is said of contact rests on these."
NO_NEARER = (
    "{theirs} follows the model more exactly, and comes no nearer to the demonstrations than {own}: they are "
    "{after:.3g} {unit} away, now {now:.3g}. Train on before you pay for more network calls."
)
STOCHASTIC = (
    "The policy samples with {sampler}, which draws noise at every step: two step counts cannot be compared "
    "sample by sample, so {own} stands for it."
)


def notes_on(
    sweep: Sweep, judgement: StepsJudgement, held_out: HeldOut, configured: Cell, own: Cell
) -> list[str]:
    """All that apply.

    Args:
        sweep: the measurement.
        judgement: of it.
        held_out: the observations.
        configured: how the policy samples.
        own: what stands for that in the sweep.
    """
    counts = sweep.reference.mode_counts
    share = f"{1 - counts[0] / sum(counts):.0%}"
    rules: list[tuple[bool, Callable[[], str]]] = [
        (sweep.reference.separation is None, lambda: ONE_MODE),
        (sweep.reference.separation is not None, lambda: SEVERAL_MODES.format(share=share)),
        (configured.sampler != own.sampler, lambda: STOCHASTIC.format(sampler=configured.sampler, own=own)),
        (held_out.seen_in_training, lambda: SEEN),
        (
            sweep.n_near_contact < FEWEST_NEAR_CONTACT,
            lambda: FEW_NEAR_CONTACT.format(n=sweep.n_near_contact),
        ),
        (judgement.limit == plateau.SPREAD, lambda: TOO_WIDE),
        (judgement.limit == plateau.CONVERGENCE, lambda: NOT_CONVERGING),
    ]
    notes = [note() for applies, note in rules if applies]
    dearer = _dearer_and_no_nearer(sweep, judgement, own)
    return notes if dearer is None else [*notes, _no_nearer(sweep, dearer, own, held_out.measure.unit)]


def _dearer_and_no_nearer(sweep: Sweep, judgement: StepsJudgement, own: Cell) -> Cell | None:
    """The recommended sampler, if it is slower and no nearer to the demonstrations.

    With several modes a blur of them would be nearest, so that the distance says nothing.
    """
    if judgement.recommended is None or sweep.reference.separation is not None:
        return None
    mine, theirs = sweep.of(own), sweep.of(judgement.recommended.cell)
    dearer = theirs.evaluations > mine.evaluations
    return theirs.cell if dearer and theirs.demonstration_error >= mine.demonstration_error else None


def _no_nearer(sweep: Sweep, recommended: Cell, own: Cell, unit: str) -> str:
    theirs = sweep.of(recommended)
    return NO_NEARER.format(
        theirs=theirs.cell,
        own=own,
        after=theirs.demonstration_error,
        now=sweep.of(own).demonstration_error,
        unit=unit,
    )
