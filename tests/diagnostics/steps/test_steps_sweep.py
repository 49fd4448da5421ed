"""The sweep of policies whose truth is known: order, plateau, modes, the model's own spread."""

import dataclasses

import numpy as np
import pytest
from fields import MEASURE, A, T, gaussian, grid_of, three_modes

from lerobot_act_chunking.diagnostics.steps.grid import Cell
from lerobot_act_chunking.diagnostics.steps.measuring import Demonstrated, Scale, run_sweep
from lerobot_act_chunking.diagnostics.steps.plateau import BELOW_MODEL, CONVERGENCE, NEAREST, PLATEAU, SPREAD
from lerobot_act_chunking.diagnostics.steps.verdict import judge

WIDTH = 0.4
SCALE = Scale(distributions=12, noises=16, tolerance=0.3, seed=3)


def sweep_of(subject, grid, scale=SCALE, demonstrated=None):
    return run_sweep(subject, grid, demonstrated or subject.demonstrated(), MEASURE, scale)


@pytest.fixture(scope="module")
def narrow():
    subject, grid = gaussian(WIDTH), grid_of()
    return subject, grid, sweep_of(subject, grid)


def gain(sampler, n, width=WIDTH):
    """What an integrator makes of the noise of a Gaussian: the exact solution has gain ``width``."""

    def slope(t, x):
        return (t * width**2 - (1 - t)) / ((t * width) ** 2 + (1 - t) ** 2) * x

    x, h = 1.0, 1 / n
    for t in np.arange(n) / n:
        first = slope(t, x)
        second = slope(t + h / 2, x + h / 2 * first) if sampler == "midpoint" else slope(t + h, x + h * first)
        x += h * {"euler": first, "midpoint": second, "heun": (first + second) / 2}[sampler]
    return x


def worst_noise(share):
    """Quantile of a chunk's largest noise, over steps and points."""
    return np.quantile(np.abs(np.random.default_rng(0).normal(size=(20000, T * A))).max(1), share)


@pytest.mark.parametrize("cell", [Cell("euler", 1), Cell("euler", 10), Cell("midpoint", 2), Cell("heun", 5)])
def test_errors_are_those_of_the_integrator(narrow, cell):
    _, _, sweep = narrow
    wrong = abs(gain(cell.sampler, cell.n_steps) - WIDTH)
    result = sweep.of(cell)
    assert result.error["p50"] == pytest.approx(wrong * worst_noise(0.5), rel=0.1)
    assert result.error["p95"] == pytest.approx(wrong * worst_noise(0.95), rel=0.1)
    assert result.error["count"] == 256
    assert result.flip_rate == 0


@pytest.mark.parametrize("sampler", ["euler", "midpoint", "heun"])
def test_orders_of_convergence(narrow, sampler):
    _, grid, sweep = narrow
    order = {each.sampler: each.order for each in judge(sweep, grid.own, 0.3, "units").series}
    n = [each for each in (5, 8, 10, 16, 20, 32, 50, 100) if Cell(sampler, each) in grid.cells]
    slope = np.polyfit(np.log(n), np.log([abs(gain(sampler, each) - WIDTH) for each in n]), 1)[0]
    assert order[sampler] == pytest.approx(-slope, abs=0.15)
    assert order["rk4"] is None  # as good as the reference from the first few steps on


def test_the_references_agree_and_the_reference_has_no_error(narrow):
    _, grid, sweep = narrow
    assert sweep.reference.cell == Cell("midpoint", 100)
    assert sweep.reference.disagreement["max"] < 1e-3
    assert grid.references[0] not in grid.cells  # 200 network calls: too dear to be swept


def test_the_models_own_spread_is_measured_near_contact(narrow):
    _, _, sweep = narrow
    assert sweep.reference.spread["p50"] == pytest.approx(WIDTH, rel=0.1)
    assert sweep.reference.spread["count"] == 6  # half of those with many samples are near contact
    assert sweep.reference.mode_counts == [12]
    assert sweep.reference.separation is None
    assert sweep.of(Cell("euler", 3)).spread == pytest.approx(gain("euler", 3), rel=0.15)


def test_distance_to_demonstrations(narrow):
    subject, _, _ = narrow
    grid = grid_of(steps=[2], samplers=["euler"])
    biased = sweep_of(subject, grid, demonstrated=subject.demonstrated(bias=9))
    expected = 9 + np.sqrt(2) * WIDTH / np.sqrt(np.pi)  # the larger of two errors, each N(9, 2 width^2)
    assert biased.reference.demonstration_error == pytest.approx(expected, rel=0.02)
    assert biased.reference.demonstration_error_near_contact["count"] == 128
    assert biased.n_near_contact == 128


def test_errors_by_phase(narrow):
    subject, _, _ = narrow
    truth = subject.demonstrated()
    near = np.zeros_like(truth.near_contact)
    near[:40, 2] = True
    sweep = sweep_of(
        subject, grid_of(steps=[3], samplers=["euler"]), demonstrated=Demonstrated(truth.actions, near)
    )
    result = sweep.of(Cell("euler", 3))
    assert result.error_near_contact["count"] == 40
    assert result.error_elsewhere["count"] == 256
    assert sweep.reference.spread["count"] == 6  # of 12 with many samples, those near contact
    assert result.error_near_contact["p50"] < result.error_elsewhere["p50"]  # one step against five
    assert set(result.error_by_point) == {"x", "y"}
    assert max(result.error_by_point.values()) <= result.error["p95"]


def test_few_steps_distort_the_distribution(narrow):
    _, _, sweep = narrow
    energy = [sweep.of(Cell("euler", n)).energy_share for n in (1, 3, 8, 20)]
    assert energy == sorted(energy, reverse=True)
    assert energy[0] > 0.2  # one Euler step gives the mean alone
    assert energy[-1] < 0.01
    assert sweep.of(Cell("euler", 50)).energy is None


@pytest.mark.parametrize("sampler", ["euler", "midpoint", "heun"])
def test_the_plateau_is_where_the_closed_form_puts_it(narrow, sampler):
    _, grid, sweep = narrow

    def is_enough(n):
        gains = gain(sampler, n), WIDTH
        demonstration_error = np.sqrt((gains[0] ** 2 + WIDTH**2) / (2 * WIDTH**2))
        return abs(gains[0] - WIDTH) * worst_noise(0.95) < 0.3 and abs(demonstration_error - 1) < 0.02

    expected = next(n for n in (1, 2, 3, 5, 8, 10, 16, 20, 32, 50, 100) if is_enough(n))
    series = judge(sweep, grid.own, 0.3, "units").series
    assert next(each.plateau for each in series if each.sampler == sampler) == expected


def test_the_cheapest_plateau_is_recommended(narrow):
    _, grid, sweep = narrow
    judgement = judge(sweep, Cell("midpoint", 5), 0.3, "units")
    assert judgement.verdict == "pass"
    assert judgement.limit is None
    assert judgement.recommended.reason == PLATEAU
    plateaus = [Cell(each.sampler, each.plateau) for each in judgement.series]
    fewest = min(grid.evaluations[cell] for cell in plateaus)
    assert judgement.recommended.evaluations == fewest
    assert f"{fewest} network calls a chunk, now 10" in judgement.reasons[1]
    best = judge(sweep, judgement.recommended.cell, 0.3, "units")
    assert best.reasons[1] == f"{best.recommended.cell} is the cheapest that is enough for it"


def test_precise_but_not_yet_on_the_plateau_warns(narrow):
    _, grid, sweep = narrow
    judgement = judge(sweep, grid.own, 0.3, "units")
    assert judgement.verdict == "warn"
    assert "euler 10 is within" in judgement.reasons[0]
    assert "is not the same yet" in judgement.reasons[0]


def test_too_few_steps_fail_and_are_told_what_is_enough(narrow):
    subject, _, _ = narrow
    grid = grid_of(Cell("euler", 1))
    judgement = judge(sweep_of(subject, grid), grid.own, 0.3, "units")
    assert judgement.verdict == "fail"
    assert "too few steps: euler 1 is" in judgement.reasons[0]
    assert "network calls a chunk, now 1" in judgement.reasons[1]
    assert f"num_inference_steps={judgement.recommended.cell.n_steps}" in judgement.recommended.flags


def test_a_spread_beyond_the_tolerance_is_the_models(narrow):
    _, grid, sweep = narrow
    judgement = judge(sweep, grid.own, 0.01, "units")
    assert judgement.limit == SPREAD
    assert judgement.verdict == "fail"
    assert "model-limited: near contact, samples for one observation spread by 0.4" in judgement.reasons[0]
    assert judgement.recommended.reason == NEAREST
    chosen = sweep.of(judgement.recommended.cell)
    assert chosen.demonstration_error <= 1.02 * min(cell.demonstration_error for cell in sweep.cells)


def test_a_blur_of_several_modes_is_not_recommended_however_near_the_demonstrations():
    subject, grid = three_modes(masses=(0.5, 0.5), width=0.2), grid_of(samplers=["euler"])
    sweep = sweep_of(subject, grid, Scale(distributions=8, noises=40, tolerance=0.01))
    judgement = judge(sweep, grid.own, 0.01, "units")
    assert sweep.reference.separation is not None
    assert judgement.limit == SPREAD
    assert judgement.recommended.reason == BELOW_MODEL
    chosen, (series,) = judgement.recommended.cell, judgement.series
    assert chosen.n_steps == series.below_model > series.nearest
    error = sweep.of(chosen).error_near_contact["p50"]
    assert error < 0.5 * sweep.reference.spread["p50"] < sweep.of(Cell("euler", 1)).error_near_contact["p50"]


def test_samples_that_agree_on_something_else_than_was_demonstrated_warn():
    subject, grid = gaussian(0.1), grid_of(Cell("midpoint", 20))
    sweep = sweep_of(subject, grid, demonstrated=subject.demonstrated(bias=2.0))
    judgement = judge(sweep, grid.own, 0.3, "units")
    assert judgement.verdict == "warn"
    assert "away from the demonstrations, more than" in judgement.reasons[0]


@dataclasses.dataclass
class Opinionated:
    """A network whose answer depends on when it is asked last; a few steps are nearest to the truth."""

    field: object
    off: dict

    noise_shape = (T, A)

    def sample(self, cell, rows, noise):
        return self.field.sample(cell, rows, noise) + self.off.get(cell.sampler, self.off.get(cell, 0.0))

    def milliseconds(self, cell):
        return None


def test_what_does_not_converge_is_the_models_limit():
    field, grid = gaussian(0.01), grid_of(samplers=["euler"])
    off = {Cell("euler", n): 2.0 for n in (1, 8, 10, 16, 20, 32, 50, 100)} | {"midpoint": 1.0, "rk4": 2.0}
    sweep = sweep_of(Opinionated(field, off), grid, demonstrated=field.demonstrated())
    judgement = judge(sweep, grid.own, 0.3, "units")
    assert judgement.verdict == "fail"
    assert judgement.limit == CONVERGENCE
    assert (
        "model-limited: more steps do not converge: even rk4 50 and midpoint 100 differ by 1 units"
        in (judgement.reasons[0])
    )
    assert judgement.recommended.reason == NEAREST
    assert judgement.recommended.cell.n_steps in (2, 3, 5)
    assert "as near to the demonstrations as any" in judgement.reasons[1]


def test_references_that_disagree_but_converge_judge_nothing():
    field, grid = gaussian(0.01), grid_of(samplers=["euler"])
    off = {Cell("euler", n): 40 / n for n in (5, 8, 10, 16, 20, 32, 50, 100)} | {"rk4": 0.4}
    sweep = sweep_of(Opinionated(field, off), grid, demonstrated=field.demonstrated())
    judgement = judge(sweep, grid.own, 0.3, "units")
    assert judgement.verdict == "inconclusive"
    assert judgement.recommended is None
    assert judgement.limit is None
    assert "midpoint 100 and rk4 50, differ by 0.4 units" in judgement.reasons[0]
    assert judgement.reasons[1:] == []


def test_few_observations_judge_nothing():
    subject, grid = gaussian(0.1, count=255), grid_of()
    judgement = judge(sweep_of(subject, grid), grid.own, 0.3, "units")
    assert judgement.verdict == "inconclusive"
    assert judgement.recommended is None
    assert "255 observations are too few" in judgement.reasons[0]


@pytest.fixture(scope="module")
def threefold():
    subject, grid = three_modes(), grid_of(samplers=["euler"])
    return sweep_of(subject, grid, Scale(distributions=6, noises=200, tolerance=0.3))


def test_modes_are_found_with_their_masses(threefold):
    assert threefold.reference.mode_counts == [0, 0, 6]
    assert threefold.reference.rarest_mode == pytest.approx(0.1, abs=0.04)
    assert threefold.reference.separation == pytest.approx(4, rel=0.15)
    assert threefold.reference.spread["p50"] == pytest.approx(0.05 * np.sqrt(1), rel=0.15)
    assert threefold.reference.spread_of_all["p50"] > 1


def test_few_steps_starve_the_rarest_mode(threefold):
    rarest = [threefold.of(Cell("euler", n)).rarest_mode for n in (2, 5, 20)]
    assert rarest[0] < 0.5 * threefold.reference.rarest_mode
    assert rarest == sorted(rarest)


def test_flips_are_counted_and_are_no_errors(threefold):
    few, many = threefold.of(Cell("euler", 5)), threefold.of(Cell("euler", 100))
    assert 0.02 < few.flip_rate < 0.4
    assert many.flip_rate < 0.02
    assert few.error["count"] == round(256 * (1 - few.flip_rate))
    assert few.error["max"] < 0.75 * threefold.reference.separation
    assert many.error["p95"] < 0.1


def test_one_step_is_a_blur_of_all_modes_and_no_flip(threefold):
    blur = threefold.of(Cell("euler", 1))
    assert blur.error["p95"] > 0.3 * threefold.reference.separation
    assert blur.energy_share > 0.2


def test_the_same_seed_gives_the_same_sweep(narrow):
    subject, _, _ = narrow
    grid = grid_of(samplers=["heun"], steps=[2, 3])
    assert sweep_of(subject, grid) == sweep_of(subject, grid)
    assert sweep_of(subject, grid) != sweep_of(subject, grid, dataclasses.replace(SCALE, seed=4))


def test_progress_reaches_what_was_planned(narrow):
    subject, _, _ = narrow
    seen = []
    for grid in (grid_of(steps=[2, 3]), grid_of(samplers=["midpoint"], steps=[4, 50])):
        run_sweep(subject, grid, subject.demonstrated(), MEASURE, SCALE, lambda *at: seen.append(at))
        assert seen[-1][0] == seen[-1][1] > 0
