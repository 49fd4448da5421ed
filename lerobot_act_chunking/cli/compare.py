"""``act-chunking compare``: which of several policies succeeds more often?"""

from typing import Annotated

import typer

from lerobot_act_chunking.cli.options import Json, Picture
from lerobot_act_chunking.cli.reporting import finish


def compare_command(
    policies: Annotated[
        list[str],
        typer.Argument(
            metavar="NAME=PATH[,PATH...]",
            help="A policy by its evaluations: folders with the eval_info.json of lerobot-eval, one for each "
            "training seed. A path alone is named by its folder.",
        ),
    ],
    unpaired: Annotated[
        bool,
        typer.Option(
            "--unpaired", help="The evaluations had other seeds or environments: episodes are not paired."
        ),
    ] = False,
    json: Json = None,
    out: Picture = None,
) -> None:
    """Compare the success rates of policies: intervals, tests, and what so many episodes can show.

    Exit status: 0 the best is surely better than each other, 10 it is not told apart from one.
    """
    from lerobot_act_chunking.diagnostics.compare.diagnosis import diagnose
    from lerobot_act_chunking.diagnostics.compare.plots import plot_report
    from lerobot_act_chunking.diagnostics.compare.settings import Settings, parse_policy
    from lerobot_act_chunking.diagnostics.compare.terminal import print_report

    report = diagnose(Settings(tuple(map(parse_policy, policies)), paired=not unpaired))
    finish(report, print_report, plot_report, json=json, picture=out)
