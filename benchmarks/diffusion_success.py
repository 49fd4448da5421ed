"""How well `diffusion_chunked` does its tasks, with how many steps: tables of docs/policies/diffusion.md.

    OMP_NUM_THREADS=1 python benchmarks/diffusion_success.py
    OMP_NUM_THREADS=1 python benchmarks/diffusion_success.py --studies variants --tasks insertion

Studies: `recipe` (three training seeds), `lerobot` (LeRobot's `diffusion` on the same data, for as long on
the same core), `variants` (objectives and denoisers) and `steps` (sampler steps against success, jerk and
milliseconds). Every policy is trained by lerobot-train on the recording of benchmarks/quickstart.py (made
first if it is not there) and acts in the same 200 episodes. Every training and every evaluation is written
down when it is done, so the studies can be stopped and gone on with, and may run side by side.
"""

from diffusion_variants import STUDIES, VARIANTS
from policy_study import run_studies

if __name__ == "__main__":
    run_studies("diffusion", __doc__, STUDIES, VARIANTS)
