"""Test signals, tick by tick, in counts: rule 8 of protocol/README.md.  Integers only.

Rule 1: a signal is its offset plus a shape; the shape never exceeds +-amplitude, so the range check at the command
        holds for every tick.
Rule 2: the fields of the command determine all counts: the same command gives the same signal.

Multisine: harmonic h has amplitude 1 and phase -h(h-1)/16 of a turn (Schroeder).  The low 7 bits of the seed flip the
signs of harmonics 2..8; the upper bits shift the signal in time.  So a seed has one of 128 peaks, which a firmware
keeps in a table; finding the peak of an arbitrary choice of phases would take it several ticks.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from gateway.emulator.firmware_model.arithmetic import PHASE_BITS, divide_rounded, sine_q15
from protocol.wire.messages import Shape

_TURN = 1 << PHASE_BITS
_HARMONICS = range(1, 9)
_PEAK_GRID = 1024  # points per period; between them the peak grows by less than 4e-4
_CHIRP_FRACTION_BITS = 16  # of the phase step, beyond those of the phase


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """The fields of EXCITE."""

    shape: int
    target: int  # 0 u_c, 1 x_ref
    amplitude: int
    offset: int
    period: int
    period_end: int
    seed: int
    duration: int  # ticks; 0: until the next command


class Excitation:
    """An active excitation; call `next` once per tick, from the tick in the ACK on."""

    def __init__(self, signal: Signal) -> None:
        self.signal = signal
        self._ticks = 0
        self._register = signal.seed % 32767 + 1
        self._phase = 0
        self._phase_step = (_TURN << _CHIRP_FRACTION_BITS) // signal.period
        last_step = (_TURN << _CHIRP_FRACTION_BITS) // signal.period_end
        self._phase_sweep = (last_step - self._phase_step) // max(signal.duration, 1)

    @property
    def has_ended(self) -> bool:
        """Return whether the duration is over, so that the signal stays at its offset."""
        return self.signal.shape == Shape.NONE or 0 < self.signal.duration <= self._ticks

    def next(self) -> int:
        """Return the signal at this tick, in counts of its target."""
        value = self.signal.offset if self.has_ended else self.signal.offset + self._shape()
        self._ticks += 1
        return value

    def _shape(self) -> int:
        ticks, amplitude, period = self._ticks, self.signal.amplitude, self.signal.period
        match self.signal.shape:
            case Shape.STEP:
                return amplitude if ticks >= period else 0
            case Shape.RECTANGLE:
                return amplitude if 2 * (ticks % period) < period else -amplitude
            case Shape.SAWTOOTH:
                return divide_rounded(2 * amplitude * (ticks % period), period) - amplitude
            case Shape.PRBS:
                if ticks and ticks % period == 0:
                    feedback = (self._register >> 14 ^ self._register >> 13) & 1
                    self._register = (self._register << 1 | feedback) & 0x7FFF
                return amplitude if self._register >> 14 else -amplitude
            case Shape.MULTISINE:
                wave = _multisine(_TURN * (ticks % period) // period, self.signal.seed)
                return _limited(divide_rounded(amplitude * wave, _multisine_peak(self.signal.seed & 0x7F)), amplitude)
            case Shape.CHIRP:
                value = divide_rounded(amplitude * sine_q15(self._phase >> _CHIRP_FRACTION_BITS), 32767)
                self._phase += self._phase_step
                self._phase_step += self._phase_sweep
                return value
        return 0


def _multisine(phase: int, seed: int) -> int:
    """Return the sum of the harmonics at `phase` of the period, Q15."""
    phase += (seed >> 7) * (_TURN >> 9)
    total = 0
    for h in _HARMONICS:
        value = sine_q15(h * phase - _TURN * h * (h - 1) // 16)
        total += -value if h > 1 and seed >> h - 2 & 1 else value
    return total


@cache
def _multisine_peak(signs: int) -> int:
    """Return the largest |value| of the multisine with these signs, Q15."""
    return max(abs(_multisine(_TURN // _PEAK_GRID * n, signs)) for n in range(_PEAK_GRID))


def _limited(value: int, amplitude: int) -> int:
    top = abs(amplitude)
    return min(max(value, -top), top)
