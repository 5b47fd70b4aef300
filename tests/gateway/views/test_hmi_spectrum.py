"""The spectrum of the last seconds: amplitude and frequency, the floor of noise, lost samples, and what it costs."""

from __future__ import annotations

import math
import re
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from playwright.sync_api import Browser, WebSocket, expect

from gateway.views.board_feed import BoardFeed
from gateway.views.hmi.spectrum import FloatArray, amplitudes, even, in_bands, missing
from gateway.views.hmi.watch import Readings, Watch
from protocol.bus import board51_pb2 as pb
from tests.harness.gateway.bus_peers import played_gateway
from tests.harness.gateway.chromium import ABSENT, CHROMIUM
from tests.harness.gateway.gateway_peers import client, wait_for
from tests.harness.gateway.hmi_peers import Page, frame, hmi
from tests.harness.gateway.rig_peers import emulated_rig
from tests.patience import HANG_MS

STEP_S, COUNT = 2e-3, 5000
T_S = STEP_S * np.arange(COUNT)
A_UM, F_HZ = 120.0, 5.0
INK = """() => {
    const canvas = document.querySelector('.spectrum canvas');
    const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
    return pixels.filter((value, n) => n % 4 === 3 && value > 0).length;
}"""


def sine(amplitude: float, frequency_hz: float, phase: float) -> FloatArray:
    return np.asarray(3000.0 + amplitude * np.sin(2.0 * np.pi * frequency_hz * T_S + phase), np.float64)


def peak(values: FloatArray) -> tuple[float, float]:
    """Frequency and amplitude of the highest band."""
    frequency_hz, amplitude = in_bands(*amplitudes(values, STEP_S))
    at = int(np.argmax(amplitude))
    return float(frequency_hz[at]), float(amplitude[at])


@given(
    amplitude=st.floats(1e-3, 1e3),
    frequency_hz=st.floats(0.5, 249.0),
    phase=st.floats(0.0, 6.3),
)
def test_a_sine_shows_its_amplitude_at_its_frequency(amplitude: float, frequency_hz: float, phase: float) -> None:
    peak_hz, peak_height = peak(sine(amplitude, frequency_hz, phase))

    # Half a step of the frequencies (1.5 % of the main lobe's height at most), and what the sine's own image leaves.
    assert peak_height == pytest.approx(amplitude, rel=0.02)
    assert peak_hz == pytest.approx(frequency_hz, rel=0.006, abs=0.03)


@given(frequency_hz=st.floats(1.0, 50.0), share=st.floats(0.0, 0.02), seed=st.integers(0, 999))
@settings(max_examples=50)
def test_few_lost_samples_leave_the_sine_as_it_is(frequency_hz: float, share: float, seed: int) -> None:
    values = sine(1.0, frequency_hz, 0.0)
    values[np.random.default_rng(seed).choice(COUNT, int(share * COUNT), replace=False)] = np.nan

    _, peak_height = peak(values)

    # Of 2 % of the samples up to (pi f T_s)^2 / 2 is lost: 5 % of each at 50 Hz; runs of several lose more.
    assert peak_height == pytest.approx(1.0, rel=0.03)


def test_white_noise_has_a_flat_floor_at_the_height_that_it_must_have() -> None:
    noise = 2.0 * np.random.default_rng(5).standard_normal(COUNT)

    frequency_hz, amplitude = amplitudes(noise, STEP_S)

    floor = 2.0 * 2.0 * math.sqrt(1.5 / COUNT)  # rms of 2 sigma sqrt(sum w^2) / sum w, Hann
    for low_hz in (1.0, 50.0, 150.0):
        part = amplitude[(frequency_hz >= low_hz) & (frequency_hz < low_hz + 50.0)]
        # Of 50 Hz about 330 ordinates are independent, each with a relative standard deviation of its power of 1.
        assert math.sqrt(float(np.mean(part**2))) == pytest.approx(floor, rel=0.15)


def test_bands_keep_the_highest_line_and_all_frequencies_rise() -> None:
    frequency_hz, amplitude = amplitudes(sine(1.0, 123.4, 0.0), STEP_S)

    band_hz, band_amplitude = in_bands(frequency_hz, amplitude)

    assert band_amplitude.max() == amplitude.max()
    assert len(band_amplitude) < 600
    assert np.all(np.diff(band_hz) > 0.0)
    assert band_hz[0] == pytest.approx(0.2)
    assert band_hz[-1] == pytest.approx(250.0, rel=0.01)


def test_samples_are_put_where_their_times_say() -> None:
    resampled = even(np.array([0.002, 0.004, 0.0101]), np.array([1.0, 2.0, 3.0]), end_s=0.01, step_s=2e-3, count=4)

    np.testing.assert_array_equal(resampled, [2.0, np.nan, np.nan, 3.0])
    assert missing(resampled) == 0.5


def test_another_clock_begins_anew() -> None:
    readings = Readings(lambda state: (state.x_m,))

    for session, t_s in ((1, 5.0), (1, 5.002), (2, 0.0), (2, 0.002)):
        readings.push(pb.State(session=session, t_s=t_s, x_m=t_s))

    np.testing.assert_array_equal(readings.table(), [[2, 0, 0], [2, 0.002, 0.002]])


def test_the_memory_of_a_reader_is_bounded_and_reaches_back_far_enough() -> None:
    readings = Readings(lambda state: (state.x_m,))

    for n in range(50_000):
        readings.push(pb.State(session=1, t_s=n * STEP_S))

    t_s = readings.table()[:, 1]
    assert 10.0 / STEP_S < len(t_s) <= 20_000
    assert t_s[-1] == 49_999 * STEP_S


class Flight:
    """A board as a feed hears it, and a reader that looks at it."""

    def __init__(self) -> None:
        self.board, self.ticks = BoardFeed("rig", threading.Lock(), lambda: 0.0), 0
        self.watch = Watch(self.board)

    def fly(self, seconds: float, *, lost: slice = slice(0), twin: bool = True) -> dict[str, Any]:
        """Take in a sine, of which the twin misses a tenth; the spectra at its end."""
        ticks = range(self.ticks, self.ticks + round(seconds / STEP_S))
        self.ticks = ticks.stop
        for n in sorted(set(ticks) - set(ticks[lost])):
            swing = A_UM * 1e-6 * math.sin(2.0 * math.pi * F_HZ * n * STEP_S)
            state = pb.State(tick=n, session=1, t_s=n * STEP_S, x_m=3e-3 + swing, i_c_a=0.6 + 100.0 * swing)
            residual = pb.SignalDivergence(error=0.1 * swing) if twin else None
            self.board.take(state, 0)
            self.board.take(pb.Divergence(tick=n, session=1, t_s=n * STEP_S, x_m=residual), 0)
        return self.watch.spectra()


def test_a_reader_sees_position_current_and_residual() -> None:
    flight = Flight()

    early, full = flight.fly(1.0), flight.fly(11.0)
    flight.watch.close()
    closed = flight.fly(1.0, lost=slice(0, 400))

    assert early == {"said": "Collecting samples: 1.0 s of at least 2 s."}
    assert (full["span_s"], full["said"]) == (10.0, "")
    for name, amplitude in (("x", A_UM), ("e", 0.1 * A_UM), ("i", 0.1 * A_UM)):
        at = int(np.argmax(full[name]))
        assert full["f_hz"][at] == pytest.approx(F_HZ, rel=0.006)
        assert full[name][at] == pytest.approx(amplitude, rel=0.02)
    assert closed == full, "who looks no more costs nothing"


@pytest.mark.parametrize(
    ("lost", "twin", "columns", "words"),
    [
        (slice(3000, 3050), True, {"x", "e", "i"}, "1 % of the samples of x were lost and are interpolated."),
        (slice(3000, 3600), True, set(), "Too many samples of x were lost (12 %), so it has no spectrum."),
        (slice(0), False, {"x", "i"}, "No twin runs"),
    ],
    ids=["a few lost", "many lost", "no twin"],
)
def test_what_is_missing_is_said_in_words(lost: slice, twin: bool, columns: set[str], words: str) -> None:
    full = Flight().fly(11.0, lost=lost, twin=twin)

    assert {name for name in ("x", "e", "i") if full[name] is not None} == columns
    assert words in full["said"]


def test_spectra_come_once_a_second_over_a_line_of_their_own(tmp_path: Path) -> None:
    with played_gateway() as gateway, hmi(tmp_path, gateway.endpoint) as (port, _):
        page = Page(port)
        page.open()
        with page.live("/live/rig/spectrum") as live:
            first = frame(live)
            gateway.state()
            wait_for(lambda: "spectra" in frame(live), "the board")
            dates = [frame(live)["at_s"] for _ in range(2)]

    assert "spectra" not in first, "of a board that nobody has heard there is nothing to say"
    assert dates[1] - dates[0] >= 0.9


@pytest.mark.slow
@pytest.mark.xdist_group("hmi-spectrum")
@pytest.mark.skipif(CHROMIUM is None, reason=ABSENT)
def test_an_excitation_of_5_hz_is_a_peak_at_5_hz(browser: Browser, tmp_path: Path) -> None:
    sine = pb.Excite(
        shape=pb.SHAPE_CHIRP, on_reference=True, amplitude=2e-4, offset=2.5e-3, period_s=1 / F_HZ,
        period_end_s=1 / F_HZ, duration_s=60.0,
    )  # fmt: skip
    with emulated_rig(tmp_path) as rig, client(rig.endpoint) as bus:
        page = browser.new_page()
        page.set_default_timeout(HANG_MS)
        errors: list[str] = []
        lines: list[WebSocket] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("websocket", lambda line: lines.append(line) if "spectrum" in line.url else None)
        page.goto(f"{rig.url}/rig/rig")
        page.wait_for_selector("body[data-live=yes]")
        page.click('[data-mode="closed loop"]')
        wait_for(lambda: bus.states()[-1].mode == pb.MODE_CLOSED_LOOP and bus.states()[-1].x_m > 1e-3, "flight")
        assert bus.command("rig", excite=sine).accepted
        begun = len(bus.states()) + 500  # then it has settled
        wait_for(lambda: len(bus.states()) > begun, "the sine")
        assert lines == [], "closed: nothing is asked for"

        page.locator(".spectrum summary").click()
        expect(page.locator(".spectrum .u-legend")).to_contain_text("10 s")
        peak_text = page.locator('[data-live="spectrum-highest"]').inner_text()
        ink = page.evaluate(INK)
        with lines[0].expect_event("close"):
            page.locator(".spectrum summary").click()
        page.close()

    flown = bus.states()[begun:][:COUNT]
    swing = [state.x_m * np.exp(-2j * np.pi * F_HZ * state.t_s) for state in flown]
    highest = re.search(r"x ([\d.]+) µm at ([\d.]+) Hz", peak_text)
    assert highest is not None, peak_text
    assert float(highest[1]) == pytest.approx(2e6 * abs(np.mean(swing)), rel=0.05)
    assert float(highest[2]) == pytest.approx(F_HZ, abs=0.05)
    assert ink > 1000, "it is drawn"
    assert errors == []
