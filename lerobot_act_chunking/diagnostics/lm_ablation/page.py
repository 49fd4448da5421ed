"""The report as a page of Markdown."""

from pathlib import Path

from lerobot_act_chunking.diagnostics.lm_ablation.report import LmAblationReport
from lerobot_act_chunking.durable_files import write_atomically


def write_page(report: LmAblationReport, picture: Path) -> Path:
    """Write ``report.md`` beside its picture; returns its path."""
    path = picture.with_name("report.md")
    write_atomically(path, "\n".join(_lines(report, picture.name)).encode())
    return path


def _lines(report: LmAblationReport, picture: str) -> list[str]:
    conditions = list(report.settings.conditions)
    match = report.match
    return [
        "# Language models as the start of a policy",
        "",
        f"**{report.verdict}**",
        "",
        *(f"- {reason}" for reason in report.reasons),
        "",
        f"![Success, learning curves, effects]({picture})",
        "",
        f"Weights of transformer and mixer: {match.parameters['bert']} and {match.parameters['mixer']} "
        f"({100 * match.parameters_apart:.2f} % apart). Work for one observation: {match.flops['bert']} and "
        f"{match.flops['mixer']} ({100 * match.flops_apart:.1f} % apart).",
        "",
        *_table(
            [
                "cell",
                "demonstrations",
                "trainings",
                *(f"{name} %" for name in conditions),
                "loss",
                "learned after",
            ],
            [
                [
                    row.cell,
                    str(row.size),
                    str(row.trainings),
                    *(f"{100 * row.success[name]:.1f}" for name in conditions),
                    f"{row.validation_loss:.3f}",
                    "never" if row.learned_after is None else f"{row.learned_after:g}",
                ]
                for row in report.rows
            ],
        ),
        "",
        *_table(
            ["effect", "condition", "demonstrations", "points", "95 % interval", "seeds"],
            [
                [
                    each.name,
                    each.condition,
                    "all" if each.size is None else str(each.size),
                    f"{100 * each.value:+.1f}",
                    f"{100 * each.interval[0]:.1f} to {100 * each.interval[1]:.1f}",
                    str(each.seeds),
                ]
                for each in report.effects
            ],
        ),
        "",
        *(f"- {note}" for note in report.notes),
        "",
    ]


def _table(names: list[str], rows: list[list[str]]) -> list[str]:
    return [f"| {' | '.join(each)} |" for each in (names, ["---"] * len(names), *rows)]
