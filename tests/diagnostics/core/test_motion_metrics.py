"""Measures of smoothness against closed forms, an independent integral and each other."""

import numpy as np
import pytest
from scipy.integrate import quad

from lerobot_act_chunking.diagnostics.core.lag import lag_products
from lerobot_act_chunking.diagnostics.core.motion_metrics import (
    high_frequency_share,
    log_dimensionless_jerk,
    median,
    moving,
    per_episode,
    rms_jerk,
    spectral_arc_length,
    speed,
    velocity_spectrum,
)
from lerobot_act_chunking.diagnostics.core.trajectories import UndefinedMeasureError

DT = 0.02


def minimum_jerk(duration: float, dt: float, amplitude: float = 1.0) -> np.ndarray:
    """A reach (T, 1) of least jerk (Flash & Hogan 1985)."""
    t = np.arange(0, duration + dt / 2, dt)[:, None] / duration
    return amplitude * (10 * t**3 - 15 * t**4 + 6 * t**5)


def step_size(hertz: float) -> float:
    """Amplitude of the difference between samples of a unit sine."""
    return 2 * np.sin(np.pi * hertz * DT)


def minimum_jerk_sparc() -> float:
    """SPARC of a minimum-jerk reach of 1 s, from the integral of its spectrum on a fine grid."""
    frequencies = np.linspace(0, 10, 4001)
    profile = [
        abs(quad(lambda t, f=f: 30 * t**2 * (1 - t) ** 2 * np.cos(2 * np.pi * f * (t - 0.5)), 0, 1)[0])
        for f in frequencies
    ]
    outline = np.array(profile[: np.flatnonzero(np.array(profile) >= 0.05)[-1] + 1])
    return -np.hypot(1 / (len(outline) - 1), np.diff(outline)).sum()


def test_sparc_of_a_minimum_jerk_reach_is_the_integral_of_its_spectrum():
    expected = minimum_jerk_sparc()
    assert expected == pytest.approx(-1.41, abs=0.01)  # as published
    for dt in (0.02, 0.005):
        assert spectral_arc_length(speed(minimum_jerk(1.0, dt), dt), dt) == pytest.approx(expected, abs=0.01)


def test_ldlj_and_jerk_of_a_minimum_jerk_reach_have_their_closed_forms():
    dt = 1e-3
    for duration, amplitude in ((1.0, 1.0), (2.5, 0.3)):
        reach = minimum_jerk(duration, dt, amplitude)
        # The integral of jerk² is 720 A²/D⁵, the peak speed 1.875 A/D.
        assert log_dimensionless_jerk(speed(reach, dt), dt) == pytest.approx(
            -np.log(720 / 1.875**2), abs=0.02
        )
        assert rms_jerk([reach], dt) == pytest.approx(np.sqrt(720) * amplitude / duration**3, rel=0.01)


@pytest.mark.parametrize("measure", [log_dimensionless_jerk, spectral_arc_length])
def test_smoothness_ignores_amplitude_and_pauses_and_falls_with_tremor(measure):
    reach = minimum_jerk(1.6, DT)
    smooth = measure(speed(reach, DT), DT)
    assert measure(speed(7 * reach, DT), DT) == pytest.approx(smooth, abs=1e-9)
    pause = np.repeat(reach[-1:], 40, axis=0)
    both = np.concatenate([reach, reach[-1] + reach[1:]])
    paused = np.concatenate([reach, pause, reach[-1] + reach[1:], reach[-1] + pause])
    assert measure(speed(paused, DT), DT) == pytest.approx(measure(speed(both, DT), DT), abs=0.5)
    tremor = 0.004 * np.sin(2 * np.pi * 7 * DT * np.arange(len(reach)))[:, None]
    assert measure(speed(reach + tremor, DT), DT) < smooth - 0.2
    assert measure(speed(both, DT), DT) < smooth - 0.2  # two movements are less smooth than one


def test_only_long_stillness_is_a_pause():
    profile = np.ones(60)
    profile[[5, 6]] = 0.0  # a turning point
    profile[20:35] = 0.01
    profile[50:] = 0.0
    expected = np.ones(60, bool)
    expected[20:35] = expected[50:] = False
    np.testing.assert_array_equal(moving(profile, DT), expected)
    profile[20:35] = 0.03  # slow, but above 2 % of the peak
    assert moving(profile, DT)[:50].all()


def test_a_ten_step_pause_is_one_and_a_nine_step_pause_is_not():
    for length, is_pause in ((10, True), (9, False)):
        profile = np.ones(40)
        profile[7 : 7 + length] = 0.0
        assert (not moving(profile, DT)[7 : 7 + length].any()) == is_pause
        assert moving(profile, DT).sum() == (40 - length if is_pause else 40)


def test_power_above_five_hertz_is_told_from_slow_power():
    t = DT * np.arange(400)[:, None]
    slow, fast = np.sin(2 * np.pi * 1.3 * t), np.sin(2 * np.pi * 9.0 * t)
    shares = [
        high_frequency_share(*velocity_spectrum([motion], DT)) for motion in (slow, fast, slow + 0.1 * fast)
    ]
    assert shares[0] < 1e-6
    assert shares[1] > 0.999
    powers = step_size(1.3) ** 2, (0.1 * step_size(9.0)) ** 2
    assert shares[2] == pytest.approx(powers[1] / sum(powers), rel=0.02)


def test_spectra_are_pooled_by_duration_and_kept_per_dimension():
    t = DT * np.arange(601)[:, None]
    slow, fast = np.sin(2 * np.pi * 1.0 * t), np.sin(2 * np.pi * 12.0 * t)
    frequencies, power = velocity_spectrum([np.hstack([slow, fast])[:301], np.hstack([fast, fast])], DT)
    density = frequencies[1]
    assert power.shape == (len(frequencies), 2)
    assert power[:, 1].sum() * density == pytest.approx((step_size(12.0) / DT) ** 2 / 2, rel=0.02)
    assert high_frequency_share(frequencies, power[:, 1:]) > 0.99
    twice = 2 * step_size(12.0) ** 2  # the second episode lasts twice as long
    assert high_frequency_share(frequencies, power[:, :1]) == pytest.approx(
        twice / (twice + step_size(1.0) ** 2), abs=5e-4
    )


def test_lag_is_found_between_samples_and_jitter_does_not_matter():
    generator = np.random.default_rng(3)
    t = DT * np.arange(300)[:, None]

    def motion(t):
        return np.sin(2 * np.pi * 0.7 * t + [0.3, 1.0]) + 0.4 * np.sin(2 * np.pi * 1.9 * t)

    for lag in (0.02, 0.05, 0.113):
        commands = motion(t) + generator.normal(0, 0.002, (300, 2))
        found = lag_products([commands], [motion(t - lag)], DT)
        assert found.lag([0, 1]).seconds == pytest.approx(lag, abs=0.003)
        assert found.lag([1]).seconds == pytest.approx(lag, abs=0.004)
    assert lag_products([commands], [commands], DT).lag([0]).seconds == 0.0


def test_the_lag_of_each_dimension_is_its_own():
    t = DT * np.arange(300)[:, None]
    commands = np.sin(2 * np.pi * 0.9 * t + [0.0, 0.7])
    positions = np.sin(2 * np.pi * 0.9 * (t - [0.04, 0.16]) + [0.0, 0.7])
    found = lag_products([commands], [positions], DT)
    assert [found.lag([dim]).seconds for dim in (0, 1)] == pytest.approx([0.04, 0.16], abs=0.003)


def test_what_is_undefined_says_why():
    still = np.zeros(50)
    for measure in (log_dimensionless_jerk, spectral_arc_length):
        with pytest.raises(UndefinedMeasureError, match="nothing moves"):
            measure(still, DT)
        assert per_episode(measure, [still], DT) == [None]
    with pytest.raises(UndefinedMeasureError, match="the speed never bends"):
        log_dimensionless_jerk(np.ones(50), DT)
    with pytest.raises(UndefinedMeasureError, match="nothing moves"):
        high_frequency_share(*velocity_spectrum([np.zeros((50, 2))], DT))
    with pytest.raises(UndefinedMeasureError, match="no frequency above 5 Hz"):
        high_frequency_share(*velocity_spectrum([np.ones((50, 2))], 0.1))
    with pytest.raises(UndefinedMeasureError, match="undefined in every episode"):
        median([None, None])
    assert median([3.0, None, 1.0]) == 2.0


def test_lag_without_motion_or_likeness_is_undefined():
    t = DT * np.arange(200)[:, None]
    wave = np.sin(2 * np.pi * 0.8 * t)
    with pytest.raises(UndefinedMeasureError, match="no command, or no motion"):
        lag_products([wave], [np.zeros_like(wave)], DT).lag([0])
    with pytest.raises(UndefinedMeasureError, match="do not resemble each other: correlation"):
        lag_products([wave], [np.random.default_rng(0).normal(size=wave.shape).cumsum(0)], DT).lag([0])
