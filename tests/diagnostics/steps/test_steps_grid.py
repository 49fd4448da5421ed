"""Which cells are swept, by process."""

import pytest
from fields import grid_of

from lerobot_act_chunking.diagnostics.steps.grid import MOST_EVALUATIONS, STEPS, Cell, make_grid
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.sampling.process import Diffusion, Flow, TwoStep

DDIM = Cell("ddim", 10, "leading")


def ddpm(n_steps=100):
    return Diffusion("epsilon", n_steps, "squaredcos_cap_v2", 1e-4, 0.02)


def steps_of(grid, sampler, spacing=None):
    return [cell.n_steps for cell in grid.cells if (cell.sampler, cell.spacing) == (sampler, spacing)]


def test_flow_takes_every_solver_up_to_a_hundred_network_calls():
    grid = grid_of()
    assert steps_of(grid, "euler") == list(STEPS)
    assert steps_of(grid, "midpoint") == [n for n in STEPS if n <= 50]
    assert steps_of(grid, "rk4") == [n for n in STEPS if n <= 20]
    assert max(grid.evaluations[cell] for cell in grid.cells) == MOST_EVALUATIONS
    assert grid.evaluations[Cell("midpoint", 8)] == 16
    assert grid.references == (Cell("midpoint", 100), Cell("rk4", 50))
    assert grid.evaluations[Cell("rk4", 50)] == 199  # the last step has a stage less


def test_ddpm_takes_every_spacing_and_what_its_schedule_allows():
    grid = make_grid(ddpm(), DDIM)
    assert steps_of(grid, "ddim", "trailing") == list(STEPS)
    assert steps_of(grid, "ddim", "leading") == steps_of(grid, "ddim", "linspace") == list(STEPS)[1:]
    assert steps_of(grid, "dpm++") == [n for n in STEPS if n <= 50]
    assert steps_of(grid, "ddpm") == []
    assert grid.references == (Cell("ddim", 100, "leading"), Cell("dpm++", 50))


def test_a_shorter_schedule_has_a_shorter_reference():
    grid = make_grid(ddpm(24), DDIM)
    assert grid.references == (Cell("ddim", 24, "leading"), Cell("dpm++", 12))
    assert steps_of(grid, "ddim", "leading") == [n for n in STEPS if 1 < n <= 24]


def test_the_policys_own_cell_is_always_there():
    assert grid_of(Cell("heun", 7)).own == Cell("heun", 7)
    grid = grid_of(Cell("heun", 7), samplers=["euler"], steps=[2, 3])
    assert grid.cells == (Cell("euler", 2), Cell("euler", 3), Cell("heun", 7))


def test_the_own_spacing_is_the_samplers_default():
    assert make_grid(ddpm(), Cell("ddim", 7)).own == Cell("ddim", 7, "leading")
    assert make_grid(ddpm(), Cell("dpm++", 7)).own == Cell("dpm++", 7)


def test_ddim_stands_for_ddpm():
    assert make_grid(ddpm(), Cell("ddpm", 100)).own == Cell("ddim", 100, "leading")


@pytest.mark.parametrize(
    ("process", "options", "message"),
    [
        (TwoStep("sample"), {}, "objective=two_step has a fixed number of network calls"),
        (
            Flow("velocity", "uniform"),
            {"samplers": ["ddim"]},
            "unknown sampler of flow 'ddim'; choose one of: euler, midpoint",
        ),
        (ddpm(), {"samplers": ["ddpm"]}, r"ddpm draws noise at every step.*sweep ddim, dpm\+\+"),
        (Flow("velocity", "uniform"), {"steps": [2, 0]}, r"step counts must be at least 1, got \[2, 0\]"),
    ],
)
def test_refuses_what_cannot_be_swept(process, options, message):
    with pytest.raises(ConfigurationError, match=message):
        make_grid(process, Cell("euler", 10), **options)


def test_names():
    assert str(Cell("ddim", 8, "trailing")) == "ddim trailing 8"
    assert str(Cell("euler", 8)) == "euler 8"
