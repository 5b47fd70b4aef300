"""The machine code of both chips: its functions, and what each of them does to variables at fixed addresses."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from firmware.sim.avr.build import compile_image
from firmware.sim.mcs51.build import image_sources
from gateway.emulator.native.flags import flags

_MODIFY = {"inc", "dec", "setb", "clr", "cpl", "anl", "orl", "xrl", "djnz", "jbc"}  # of an 8051, each without a gap


@dataclass(frozen=True, slots=True)
class Access:
    """An access of one instruction to a byte of memory."""

    function: str
    variable: str
    writes: bool
    guarded: bool  # no interrupt comes
    is_atomic: bool  # it reads and writes in one instruction
    size: int  # of the variable, bytes


@dataclass(frozen=True, slots=True)
class Program:
    """A program: the functions that each function calls, and the accesses."""

    calls: Mapping[str, set[str]]
    accesses: list[Access]

    def reached(self, roots: Iterable[str]) -> set[str]:
        """The functions that these call, at any depth, and these."""
        reached: set[str] = set()
        todo = list(roots)
        while todo:
            name = todo.pop()
            if name not in reached:
                reached.add(name)
                todo += self.calls.get(name, set())
        return reached


def mcs51_program(folder: Path) -> Program:
    """Compile the image of the 8051 in `folder` and read sdcc's assembler."""
    texts = []
    for source in image_sources():
        out = folder / f"{source.stem}.rel"
        command = [str(shutil.which("sdcc")), *flags("MCS51_FLAGS", "MCS51_CONFIG"), "-c", str(source), "-o", str(out)]
        subprocess.run(command, check=True, cwd=folder)
        texts.append(out.with_suffix(".asm").read_text(encoding="utf-8"))
    sizes = {name: int(size) for name, size in re.findall(r"^_(\w+):+\n\t\.ds\s+(\d+)", texts[0], re.M)}
    calls: dict[str, set[str]] = {}
    accesses: list[Access] = []
    for text in texts:
        for name, code in re.findall(r"^_(\w+):\n(.*?)(?=^_\w+:\n|\Z)", text.partition(".area CSEG")[2], re.M | re.S):
            calls[name] = set(re.findall(r"l(?:call|jmp)\t_(\w+)", code))
            accesses += _of_mcs51(name, code, sizes)
    return Program(calls, accesses)


def _of_mcs51(function: str, code: str, sizes: Mapping[str, int]) -> Iterable[Access]:
    guarded = function == "main"  # until it admits them
    pointer: int | None = None  # into `board`
    for line in re.findall(r"^\t(\w+(?:\t[^;\n]*)?)", code, re.M):
        operation, _, operands = line.partition("\t")
        if re.fullmatch(r"clr\t_E(A|T2)|jbc\tea,.*", line):
            guarded = True
        elif re.fullmatch(r"setb\t_E(A|T2)|mov\tea,c", line):
            guarded = False
        elif address := re.fullmatch(r"mov\tdptr,#\(_b51_board \+ (0x\w+)\)", line):
            pointer = int(address[1], 16)
        elif line == "inc\tdptr":
            pointer = None if pointer is None else pointer + 1
        elif operation == "movx" and pointer is not None:
            yield Access(function, f"board+{pointer}", operands.startswith("@"), guarded, False, 1)
        elif operation == "lcall" or re.match(r"mov\tdp", line):
            pointer = None
        else:
            for n, operand in enumerate(operands.split(",")):
                name = re.fullmatch(r"\(?_(\w+?)(?: \+ \d+\))?", operand)
                if name and name[1] in sizes and "sloc" not in name[1]:
                    is_atomic = operation in _MODIFY
                    writes = n == 0 and (is_atomic or operation in ("mov", "pop"))
                    yield Access(function, name[1], writes, guarded, is_atomic, sizes[name[1]])


def avr_program(folder: Path) -> Program:
    """Compile the image of the AVR in `folder` and disassemble it."""
    elf = folder / "avr.elf"
    compile_image(elf)
    symbols = [row.split() for row in _output("avr-nm", "-S", elf).splitlines()]
    variables = [(int(at, 16) & 0xFFFF, int(size, 16), name) for at, size, kind, name in
                 (row for row in symbols if len(row) == 4) if kind in "bBdD"]  # fmt: skip
    calls: dict[str, set[str]] = {}
    accesses: list[Access] = []
    listing = _output("avr-objdump", "-d", elf)
    for name, code in re.findall(r"^\w+ <(\w+)>:\n(.*?)(?=^\w+ <|\Z)", listing, re.M | re.S):
        calls[name] = set(re.findall(r"\t(?:r?call|r?jmp)\t.*<(\w+)>", code))
        guarded = name == "main"
        for operation, operands in re.findall(r"^ +\w+:\t[\w ]+\t(\w+)(?:\t([^;\n]*))?", code, re.M):
            if operation == "cli":
                guarded = True
            elif operation == "sei" or operands.startswith("0x3f"):
                guarded = False
            elif operation in ("lds", "sts"):
                at = int(re.findall(r"0x\w+", operands)[0], 16)
                variable, size = _variable(at, variables)
                accesses.append(Access(name, variable, operation == "sts", guarded, False, size))
    return Program(calls, accesses)


def _variable(at: int, variables: Iterable[tuple[int, int, str]]) -> tuple[str, int]:
    """The name of what lies at an address, and its size; a byte of `board` is a variable."""
    for begin, size, name in variables:
        if begin <= at < begin + size:
            return (f"board+{at - begin}", 1) if name == "b51_board" else (name, size)
    return f"register {at:#x}", 1


def _output(program: str, *arguments: str | Path) -> str:
    return subprocess.run([program, *arguments], check=True, capture_output=True, text=True).stdout
