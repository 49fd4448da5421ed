from types import SimpleNamespace

import pytest

from lerobot_act_chunking.diagnostics.latent.figures import Group, Health, PriorCheck
from lerobot_act_chunking.diagnostics.latent.settings import Thresholds
from lerobot_act_chunking.diagnostics.latent.verdict import Measurements, judge


def measured(
    *,
    active=True,
    by_place=0.1,
    shuffled=0.2,
    outside=0.01,
    starved=0.0,
    groups=(),
    is_fitted=False,
    **config,
):
    usual = {"kl_weight": 10.0, "z_inference": "sample", "latent_type": "gaussian"}
    return Measurements(
        config=SimpleNamespace(**{**usual, **config}),
        health=Health(1.5, [1.5, 0.0], [0.4 if active else 1e-4, 1e-4], by_place),
        errors={"posterior": 0.1, "shuffled": shuffled},
        acting=PriorCheck("p", outside, starved, []),
        groups=list(groups),
        is_fitted=is_fitted,
    )


def found(**facts):
    judgement = judge(measured(**facts), Thresholds())
    return judgement.diagnosis, judgement.verdict, "; ".join(judgement.reasons)


def test_healthy():
    diagnosis, verdict, reasons = found()
    assert (diagnosis, verdict) == ("healthy", "pass")
    assert "tells 1.5 nats, another demonstration's style raises the error by 100%" in reasons


def test_a_latent_that_never_differs_has_collapsed():
    diagnosis, verdict, reasons = found(active=False)
    assert (diagnosis, verdict) == ("posterior collapse", "warn")
    assert "no dimension of the latent differs between demonstrations (variance 0.0001)" in reasons
    assert "--policy.kl_weight (now 10, try 1)" in reasons


def test_a_latent_that_the_decoder_does_not_hear_has_collapsed():
    diagnosis, _, reasons = found(shuffled=0.103)
    assert diagnosis == "posterior collapse"
    assert "changes the error by 3.0% only" in reasons


def test_collapse_comes_before_holes():
    assert found(active=False, outside=0.9)[0] == "posterior collapse"


@pytest.mark.parametrize(
    ("facts", "told"),
    [
        ({"outside": 0.3}, "30% of the prior's samples are unlike every demonstrated style"),
        ({"starved": 0.05}, "hardly samples styles that 5% of the demonstrations have"),
    ],
)
def test_a_prior_hole(facts, told):
    diagnosis, verdict, reasons = found(**facts)
    assert (diagnosis, verdict) == ("prior hole", "fail")
    assert told in reasons
    assert "act-chunking fit-prior" in reasons


def test_a_hole_is_no_failure_where_nothing_is_sampled():
    _, verdict, reasons = found(outside=0.3, z_inference="mode")
    assert verdict == "warn"
    assert "z_inference=mode" in reasons


def test_styles_of_situations_need_a_prior_that_sees_them():
    diagnosis, verdict, reasons = found(by_place=0.6, is_fitted=True)
    assert (diagnosis, verdict) == ("prior hole", "fail")
    assert "60% of what tells styles apart follows from the place in the episode" in reasons
    assert "--policy.latent_type=conditional" in reasons
    assert found(by_place=0.6, latent_type="conditional")[0] == "healthy"


@pytest.mark.parametrize(
    ("facts", "remedy"),
    [
        ({"is_fitted": True}, "fit it to them again"),
        ({"latent_type": "mixture"}, "--policy.latent_type=gaussian and act-chunking fit-prior"),
        ({"latent_type": "categorical"}, "train for longer"),
    ],
)
def test_the_remedy_depends_on_the_prior(facts, remedy):
    assert remedy in found(outside=0.3, **facts)[2]


def test_a_group_that_not_even_its_own_style_reconstructs():
    groups = (Group(0.9, 0.09), Group(0.09, 0.25), Group(0.005, 0.9), Group(0.005, None))
    diagnosis, verdict, reasons = found(groups=groups)
    assert (diagnosis, verdict) == ("healthy", "warn")
    assert "not learned group 2 (9% of the demonstrations, 2.5 times the usual error): train for" in reasons
