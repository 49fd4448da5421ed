"""From the finished trainings to the report."""

from collections.abc import Sequence
from statistics import fmean, median

import numpy as np

from lerobot_act_chunking.diagnostics.lm_ablation.cells import CELLS, REFERENCE
from lerobot_act_chunking.diagnostics.lm_ablation.effects import FACTORIAL_EFFECTS, Effect, effect
from lerobot_act_chunking.diagnostics.lm_ablation.matching import Match
from lerobot_act_chunking.diagnostics.lm_ablation.records import Record
from lerobot_act_chunking.diagnostics.lm_ablation.report import LmAblationReport, Row
from lerobot_act_chunking.diagnostics.lm_ablation.settings import Settings
from lerobot_act_chunking.diagnostics.lm_ablation.verdict import judge

ALONE = "{cell} is trained with one seed: its rates say nothing of other trainings."
FEW = "Intervals are of a bootstrap over {n} training seeds: with so few they are rather too narrow."
UNSURE = (
    "Intervals are of one effect each: of {n} that are shown, one in twenty leaves out zero by chance. The "
    "verdict goes by pretraining over all sizes, corrected for the number of conditions (Holm)."
)


def measure(settings: Settings, records: Sequence[Record], match: Match) -> LmAblationReport:
    """Every cell at every size, the effects, and the verdict.

    Args:
        settings: what is asked.
        records: finished trainings, of all cells.
        match: of both architectures.
    """
    order = list(CELLS)
    records = sorted(records, key=lambda each: (order.index(each.cell), each.size, each.seed))
    sizes = [each for each in settings.sizes if any(each == record.size for record in records)]
    conditions = list(settings.conditions)
    effects = _effects(records, conditions, sizes)
    rows = _rows(settings, records)
    notes = []
    alone = {row.cell: None for row in rows if row.trainings == 1}
    notes += [ALONE.format(cell=", ".join(alone))] if alone else []
    if effects:
        notes += [FEW.format(n=min(each.seeds for each in effects)), UNSURE.format(n=len(effects))]
    return LmAblationReport(
        judgement=judge(settings, match, effects, sizes),
        settings=settings,
        match=match,
        rows=rows,
        effects=effects,
        records=records,
        notes=notes,
    )


def _effects(records: Sequence[Record], conditions: Sequence[str], sizes: Sequence[int]) -> list[Effect]:
    """Of the two by two, then of each cell against the random transformer; over all sizes first."""
    rng = np.random.default_rng(0)
    present = {each.cell for each in records} - {REFERENCE}
    compared = {name: {name: 1.0, REFERENCE: -1.0} for name in CELLS if name in present}
    chosen = [list(sizes), *([size] for size in sizes)] if len(sizes) > 1 else [list(sizes)]
    found = [
        effect(name, weights, records, condition, each, rng)
        for name, weights in {**FACTORIAL_EFFECTS, **compared}.items()
        for condition in conditions
        for each in chosen
        if each
    ]
    return [each for each in found if each is not None]


def _rows(settings: Settings, records: Sequence[Record]) -> list[Row]:
    rows = []
    for cell, size in dict.fromkeys((each.cell, each.size) for each in records):
        own = [each for each in records if (each.cell, each.size) == (cell, size)]
        learned = [each.learned_after(settings.thresholds.loss_share) for each in own]
        never = settings.budget.steps + 1
        middle = median(never if each is None else each for each in learned)
        kinds = sorted({kind for each in own for kind in each.moved})
        rows.append(
            Row(
                cell=cell,
                size=size,
                trainings=len(own),
                success={
                    name: fmean(map(fmean, (each.successes[name] for each in own)))
                    for name in own[0].successes
                },
                validation_loss=fmean(each.best_loss for each in own),
                learned_after=None if middle == never else middle,
                moved={kind: fmean(each.moved.get(kind, 0.0) for each in own) for kind in kinds},
                seconds=fmean(each.seconds for each in own),
            )
        )
    return rows
