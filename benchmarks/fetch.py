"""How well policies move the Fetch arm: the tables of docs/guides/robotics.md.

    OMP_NUM_THREADS=1 python benchmarks/fetch.py
    OMP_NUM_THREADS=1 python benchmarks/fetch.py --studies execution --tasks FetchPush-v4

Studies: `policies` (every policy type of the package and LeRobot's `act`, on the same data), `velocities`
(the same where velocities are observed, as in the original) and `execution` (chunk length against the
interval of replanning). Every policy is trained by lerobot-train on 100 demonstrations (recorded first if
they are not there) and acts in the same 200 episodes; what counts is their last step. Every training and
every evaluation is written down when it is done, so the studies can be stopped and gone on with, and may run
side by side.
"""

from fetch_variants import STUDIES, VARIANTS
from policy_study import run_studies

TASKS = ("FetchPickAndPlace-v4", "FetchPush-v4")

if __name__ == "__main__":
    run_studies("fetch", __doc__, STUDIES, VARIANTS, tasks=TASKS, recordings="fetch")
