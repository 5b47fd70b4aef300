"""The simulated 8051 against ucsim's: every opcode, and sequences of them, from random states to the same ones.

ucsim (Debian: sdcc-ucsim) is a second, independent description of the processor, and counts cycles of the 12T family.
The cycles of the 1T part are the data sheet's table alone.
"""

from __future__ import annotations

import random
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import pytest

from firmware.sim.mcs51.build import simulator
from firmware.sim.mcs51.library import Chip, load
from tests.harness.gateway.board_host import skip_without_compiler
from tests.patience import HANG_S

SP, DPL, DPH, PSW, ACC, B, CFG841, P2 = 0x81, 0x82, 0x83, 0xD0, 0xE0, 0xF0, 0xAF, 0xA0
REGISTERS = (SP, DPL, DPH, PSW, ACC, B)  # what no peripheral stands behind
RESERVED = 0xA5
CLOCKS = 12  # of a machine cycle
PAGE = 256  # of external RAM, which MOVX may reach here
START = 0x4100
# Opcodes whose second byte is a direct address, and whose is a bit; of 0x85 and those of CJNE the others are free.
DIRECT = {row << 4 | 5 for row in (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14, 15)} | {0xC0, 0xD0}
DIRECT |= {row << 4 | column for row in (4, 5, 6) for column in (2, 3)}
DIRECT |= {row << 4 | column for row in (8, 10) for column in range(6, 16)}
READS = {row << 4 | 5 for row in (2, 3, 4, 5, 6, 9, 11, 14)} | {0xC0} | {0xA0 | column for column in range(6, 16)}
BITS = {0x10, 0x20, 0x30, 0x72, 0x82, 0x92, 0xA0, 0xA2, 0xB0, 0xB2, 0xC2, 0xD2}
BRANCHES = {
    0x02,
    0x12,
    0x22,
    0x32,
    0x73,
    0x80,
    *(row << 4 | 1 for row in range(16)),
    *(row << 4 for row in range(1, 8)),
}
BRANCHES |= {0xB0 | column for column in range(4, 16)} | {0xD5, *range(0xD8, 0xE0)}
MOVX_VIA_REGISTER = {0xE2, 0xE3, 0xF2, 0xF3}


@dataclass(frozen=True, kw_only=True)
class Case:
    """A state, and a number of instructions."""

    code: bytes
    ram: bytes
    registers: tuple[int, ...]
    steps: int


@dataclass(frozen=True, kw_only=True)
class State:
    """The state that the emulator and ucsim are both asked for."""

    pc: int
    ram: bytes
    registers: tuple[int, ...]
    external: bytes
    cycles: int


@pytest.fixture(scope="module")
def external() -> bytes:
    """External RAM at the start of each case."""
    return random.Random(1).randbytes(PAGE)


@pytest.fixture(autouse=True)
def _programs() -> None:
    skip_without_compiler()
    if shutil.which("s51") is None:
        pytest.skip("s51 is not installed")


@pytest.mark.slow
def test_every_opcode_does_what_ucsim_does(external: bytes) -> None:
    chance = random.Random(51)
    cases = [a_case(chance, [opcode], 1) for opcode in range(256) if opcode != RESERVED for _ in range(2)]

    assert differences(cases, external) == []


def test_sequences_of_instructions_do_what_they_do_in_ucsim(external: bytes) -> None:
    chance = random.Random(8051)
    straight = sorted({*range(256)} - BRANCHES - {RESERVED})
    cases = [a_case(chance, chance.choices(straight, k=24), 24) for _ in range(40)]

    assert differences(cases, external) == []


def test_the_comparison_would_tell(external: bytes) -> None:
    """A different program in the two is a difference."""
    chance = random.Random(2)
    case = a_case(chance, [0x24], 1)
    other = Case(code=b"\x94" + case.code[1:], ram=case.ram, registers=case.registers, steps=1)

    assert in_ucsim([case], external) != in_emulator([other], external)


def a_case(chance: random.Random, opcodes: Sequence[int], steps: int) -> Case:
    code = b"".join(instruction(chance, opcode) for opcode in opcodes)
    psw, acc, b = chance.randbytes(3)
    # Parity is the accumulator's, whatever is written to its bit: ucsim keeps what was written until A changes.
    registers = (chance.randrange(0x20, 0xF0), chance.randrange(256), 0, psw & ~1 | acc.bit_count() & 1, acc, b)
    return Case(code=code, ram=chance.randbytes(256), registers=registers, steps=steps)


def instruction(chance: random.Random, opcode: int) -> bytes:
    operands = bytearray(chance.randbytes(2))
    if opcode in DIRECT:
        operands[0] = a_direct(chance, written=opcode not in READS)
    elif opcode in BITS:
        operands[0] = a_bit(chance)
    if opcode == 0x85:
        operands[1] = a_direct(chance, written=True)
    if opcode == 0x90:
        operands[0] = 0  # the page of external RAM that is compared
    return bytes((opcode, *operands[: length(opcode) - 1]))


def length(opcode: int) -> int:
    row, column = opcode >> 4, opcode & 15
    if opcode in {0x02, 0x12, 0x10, 0x20, 0x30, 0x43, 0x53, 0x63, 0x75, 0x85, 0x90, 0xD5} or 0xB4 <= opcode < 0xC0:
        return 3
    two = opcode in DIRECT or opcode in BITS or column == 1 or opcode in {0x40, 0x50, 0x60, 0x70, 0x80}
    two = two or (column == 4 and (2 <= row <= 7 or row == 9)) or (column >= 6 and row == 7) or 0xD8 <= opcode <= 0xDF
    return 2 if two else 1


def a_direct(chance: random.Random, *, written: bool) -> int:
    # DPH stays: external RAM is compared in one page.
    return chance.choice(
        (chance.randrange(128), chance.choice((DPL, ACC, B) if written else (SP, DPL, DPH, PSW, ACC, B)))
    )


def a_bit(chance: random.Random) -> int:
    return chance.choice(
        (chance.randrange(128), ACC + chance.randrange(8), B + chance.randrange(8), PSW + chance.randrange(1, 8))
    )


def differences(cases: list[Case], external: bytes) -> list[tuple[str, State, State]]:
    pairs = zip(cases, in_ucsim(cases, external), in_emulator(cases, external), strict=True)
    return [(case.code.hex(), theirs, emulated) for case, theirs, emulated in pairs if theirs != emulated][:3]


def in_emulator(cases: Iterable[Case], external: bytes) -> list[State]:
    library, chip, states = load(simulator()), Chip(), []
    chip.cpu.slow = 1
    library.chip_power_on(chip)
    chip.cpu.code[:] = b"\xff" * len(chip.cpu.code)
    for case in cases:
        cpu = chip.cpu
        cpu.ram[:] = case.ram
        cpu.sfr[CFG841 - 128] = 1
        for register, value in zip(REGISTERS, case.registers, strict=True):
            cpu.sfr[register - 128] = value
        cpu.xram[:PAGE] = external
        cpu.code[START : START + len(case.code)] = case.code
        cpu.pc = START
        before = cpu.cycles
        for _ in range(case.steps):
            library.cpu_step(chip)
        acc, psw = cpu.sfr[ACC - 128], cpu.sfr[PSW - 128]
        cpu.sfr[PSW - 128] = psw & ~1 | acc.bit_count() & 1  # the processor makes the parity when it is read
        states.append(
            State(
                pc=cpu.pc,
                ram=bytes(cpu.ram),
                registers=tuple(cpu.sfr[register - 128] for register in REGISTERS),
                external=bytes(cpu.xram[:PAGE]),
                cycles=cpu.cycles - before,
            )
        )
    return states


def in_ucsim(cases: Sequence[Case], external: bytes) -> list[State]:
    lines = [f"set memory sfr {P2} 0"]
    for case in cases:
        lines += [
            "set memory iram 0 " + numbers(case.ram),
            *(f"set memory sfr {register} {value}" for register, value in zip(REGISTERS, case.registers, strict=True)),
            "set memory xram 0 " + numbers(external),
            f"set memory rom {START} {numbers(case.code)}",
            f"pc {START}",
            "state",
            f"step {case.steps}",
            "state",
            "dump iram 0 255 256",
            *(f"dump sfr {register} {register}" for register in REGISTERS),
            "dump xram 0 255 256",
        ]
    with tempfile.NamedTemporaryFile(
        "w", suffix=".cmd"
    ) as script:  # what comes by the console is echoed into the answers
        script.write("\n".join([*lines, "quit", ""]))
        script.flush()
        command = ["s51", "-q", "-t", "8052", "-C", script.name]
        process = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=True, timeout=HANG_S
        )
    blocks = process.stdout.split("CPU state=")[1:]  # one for each `state`, with what is printed until the next
    return [parse(after, clocks(before)) for before, after in zip(blocks[::2], blocks[1::2], strict=True)]


def parse(block: str, clocks_before: int) -> State:
    head, dumps = block.split("Simulation: stopped\n", 1)
    lines = [line for line in dumps.splitlines() if line.startswith("0x")][: len(REGISTERS) + 2]
    return State(
        pc=int(re.findall(r"PC= 0x(\w+)", head)[0], 16),
        ram=memory(lines[0]),
        registers=tuple(register(line) for line in lines[1:-1]),
        external=memory(lines[-1]),
        cycles=(clocks(block) - clocks_before) // CLOCKS,
    )


def register(line: str) -> int:
    return int(re.findall(r" 0b[01]{8} 0x(\w\w)" if ": " in line else r"^0x\w\w +(\w\w)", line)[0], 16)


def memory(line: str) -> bytes:
    return bytes.fromhex(re.findall(rf"^0x\w+ +((?:\w\w ){{{PAGE}}})", line)[0])


def clocks(block: str) -> int:
    return int(re.findall(r"last reset= [\d.e-]+ sec \((\d+) clks", block)[0])


def numbers(data: bytes) -> str:
    return " ".join(map(str, data))
