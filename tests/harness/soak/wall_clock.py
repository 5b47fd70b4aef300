"""A wall clock of a process that can be stepped while it runs; the clock of this machine is not touched.

A library that the process loads before all others adds an offset, from a mapped file, to what the C library says of
Unix time.  Python and zenoh both ask it.  Monotonic clocks stay as they are, and waits for a Unix time in the kernel.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

_SOURCE = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>

static volatile long long *offset_ns;
static int (*real)(clockid_t, struct timespec *);

__attribute__((constructor)) static void load(void) {
    int file = open(getenv("SOAK_CLOCK"), O_RDONLY);
    real = dlsym(RTLD_NEXT, "clock_gettime");
    offset_ns = mmap(0, sizeof *offset_ns, PROT_READ, MAP_SHARED, file, 0);
}

int clock_gettime(clockid_t id, struct timespec *at) {
    if (!real) load();  /* other libraries load before this one */
    int failed = real(id, at);
    if (!failed && (id == CLOCK_REALTIME || id == CLOCK_REALTIME_COARSE)) {
        long long ns = at->tv_sec * 1000000000LL + at->tv_nsec + *offset_ns;
        at->tv_sec = ns / 1000000000, at->tv_nsec = ns % 1000000000;
    }
    return failed;
}

int gettimeofday(struct timeval *restrict at, void *restrict zone) {
    struct timespec now;
    (void)zone, clock_gettime(CLOCK_REALTIME, &now);
    at->tv_sec = now.tv_sec, at->tv_usec = now.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *at) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    return at ? *at = now.tv_sec : now.tv_sec;
}
"""


class WallClock:
    """The wall clock of one process, over all its lives.

    Args:
        folder: For the library and the offset.
        name: Of the files.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self._offset_ns = 0
        self._file = folder / f"{name}.clock"
        self.environment: dict[str, str] = {}  # of the process; empty: the clock never steps
        self.step(0)
        if sys.platform == "linux" and (compiler := shutil.which("gcc")):
            library = folder / f"{name}.so"
            words = [compiler, "-shared", "-fPIC", "-O1", "-x", "c", "-", "-o", str(library), "-ldl"]
            subprocess.run(words, input=_SOURCE.encode(), check=True)
            self.environment = {"LD_PRELOAD": str(library), "SOAK_CLOCK": str(self._file)}

    def step(self, step_s: float) -> None:
        """Step it, forwards or backwards."""
        self._offset_ns += round(step_s * 1e9)
        with self._file.open("r+b" if self._file.exists() else "xb") as file:  # the mapping stays valid
            file.write(self._offset_ns.to_bytes(8, "little", signed=True))
