"""The ``act-chunking`` command: parse, call one function, print.

Nothing here imports torch or LeRobot, so that ``--help`` answers at once; each command imports what it needs.
"""

import sys

import typer

from lerobot_act_chunking.cli import hub
from lerobot_act_chunking.cli.bandwidth import bandwidth_command
from lerobot_act_chunking.cli.check import RobotCommand, check_command
from lerobot_act_chunking.cli.codebook import codebook_command
from lerobot_act_chunking.cli.compare import compare_command
from lerobot_act_chunking.cli.data import data_command
from lerobot_act_chunking.cli.diagnose import diagnose_command
from lerobot_act_chunking.cli.environment import EnvironmentCommand
from lerobot_act_chunking.cli.eval import eval_command
from lerobot_act_chunking.cli.export import export_command
from lerobot_act_chunking.cli.fit_prior import fit_prior_command, latent_command
from lerobot_act_chunking.cli.import_checkpoint import import_command
from lerobot_act_chunking.cli.lm_ablation import TrainingCommand, lm_ablation_command
from lerobot_act_chunking.cli.modes import modes_command
from lerobot_act_chunking.cli.motion import motion_command
from lerobot_act_chunking.cli.quickstart import quickstart_command
from lerobot_act_chunking.cli.record import record_command
from lerobot_act_chunking.cli.replay import replay_command
from lerobot_act_chunking.cli.resolution import resolution_command
from lerobot_act_chunking.cli.running import run
from lerobot_act_chunking.cli.serve import PolicyCommand, serve_command
from lerobot_act_chunking.cli.settings import settings_command
from lerobot_act_chunking.cli.smoothness import smoothness_command
from lerobot_act_chunking.cli.steps import steps_command
from lerobot_act_chunking.cli.train_tokenizer import train_tokenizer_command
from lerobot_act_chunking.cli.tune import tune_command
from lerobot_act_chunking.cli.wrap import wrap_command

EXIT_STATUS = (
    "Exit status: 0 done, or a verdict that is no failure; 1 refused, with the reason; 2 wrong usage; "
    "10 a verdict of inconclusive; 11 of fail; 130 stopped by Ctrl-C."
)

app = typer.Typer(
    name="act-chunking",
    help="Action-chunking policies for LeRobot: demonstrations, training, chunk execution, diagnosis.",
    epilog=EXIT_STATUS,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
app.command("quickstart")(quickstart_command)
app.command("record")(record_command)
app.command("train-tokenizer")(train_tokenizer_command)
app.command("fit-prior")(fit_prior_command)
app.command("import")(import_command)
app.command("wrap")(wrap_command)
app.command("export", cls=PolicyCommand)(export_command)
app.command("serve", cls=PolicyCommand)(serve_command)
app.command("tune", cls=EnvironmentCommand)(tune_command)
app.command("settings")(settings_command)
app.command("data")(data_command)
app.command("motion", cls=EnvironmentCommand)(motion_command)
app.command("smoothness", cls=EnvironmentCommand)(smoothness_command)
app.command("bandwidth")(bandwidth_command)
app.command("replay")(replay_command)
app.command("resolution")(resolution_command)
app.command("latent")(latent_command)
app.command("eval", cls=EnvironmentCommand)(eval_command)
app.command("modes", cls=EnvironmentCommand)(modes_command)
app.command("compare")(compare_command)
app.command("check", cls=RobotCommand)(check_command)
app.command("diagnose", cls=EnvironmentCommand)(diagnose_command)
app.command("steps", cls=EnvironmentCommand)(steps_command)
app.command("lm-ablation", cls=TrainingCommand)(lm_ablation_command)
app.command("codebook")(codebook_command)
app.add_typer(hub.app, name="hub")


def main(argv: list[str] | None = None) -> int:
    """Run the command line; returns the exit status, as `EXIT_STATUS` lists them."""
    return run(app, argv, "act-chunking")


if __name__ == "__main__":
    sys.exit(main())
