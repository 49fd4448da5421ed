"""How well `act_chunked` does its tasks, and what its parts are for: the tables of docs/policies/act.md.

    OMP_NUM_THREADS=1 python benchmarks/act_success.py --studies headline lerobot
    OMP_NUM_THREADS=1 python benchmarks/act_success.py --studies likelihoods --tasks insertion

Studies: `headline` (preset `base` as it comes, three training seeds), `lerobot` (its
`act` for as many minutes) and, one setting changed at a time in half the quickstart's steps, `likelihoods`,
`decoders`, `latents`, `resolution`, `history` and `presets`. Every policy is trained by lerobot-train on the
recording of benchmarks/quickstart.py (made first if it is not there) and acts in the same 200 episodes. Every
training and every evaluation is written down when it is done, so the studies can be stopped and gone on with,
and may run side by side.
"""

from act_variants import STUDIES, VARIANTS
from policy_study import run_studies

if __name__ == "__main__":
    run_studies("act", __doc__, STUDIES, VARIANTS)
