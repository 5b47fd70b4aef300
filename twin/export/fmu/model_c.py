"""`model.h` and `model.c` of an FMU: the translated rig, its numbers and the table of variables."""

from __future__ import annotations

from twin.control import LawNumbers
from twin.export.rig import Rig
from twin.export.translate.c import functions, number
from twin.export.variables import Variable
from twin.model.causes.catalogue import neutral
from twin.model.causes.cause import PLACES
from twin.model.extended import Base
from twin.model.simulate import ACT, INTEGRAL, SENSE, X_BEFORE, X_READ

_ROLES = {"parameter": "TUNABLE", "fixed": "FIXED", "input": "INPUT", "output": "OUTPUT"}


def header(rig: Rig, listed: list[Variable], sample_time_s: float, token: str) -> str:
    """The text of `model.h`."""
    law = ", ".join(field for field in LawNumbers._fields if field != "sample_time_s")
    starts = ", ".join(variable.field for variable in listed if variable.field.endswith("_start"))
    return f"""\
/* Written by `board51 export-model`: the numbers of one identified rig. */
#ifndef MODEL_H
#define MODEL_H
#include <stddef.h>

#define MODEL_TOKEN "{token}"
#define SAMPLE_TIME_S {number(sample_time_s)}
#define VARIABLES {len(listed)} /* value references 0 .. VARIABLES - 1 are numbers */
#define CLOSED_LOOP VARIABLES /* value reference of the one truth value */

typedef struct {{
    double {", ".join(Base._fields)};
    double c[{PLACES}]; /* parameters of the causes; most are neutral */
    double {law};
    double {starts};
    double u_c, x_ref; /* inputs */
    double u; /* output; the others are in memory */
    int closed_loop;
    int act_whole, sense_whole; /* delays of u_c and of the readings: whole ticks and the rest, s */
    double act_part_s, sense_part_s;
    double memory[{rig.places}];
}} Model;

typedef enum {{ TUNABLE, FIXED, INPUT, OUTPUT }} Role;

typedef struct {{
    const char *name;
    size_t place; /* bytes from the beginning of Model */
    Role role;
    double start, low, high;
}} Variable;

extern const Variable variables[VARIABLES];

void model_reset(Model *m); /* all variables at their start values */
void model_begin(Model *m); /* the rig at the beginning */
void model_tick(Model *m); /* one SAMPLE_TIME_S under the inputs */
#endif
"""


def source(rig: Rig, listed: list[Variable], title: str) -> str:
    """The text of `model.c`."""
    rows = ",\n".join(
        f'    {{"{v.name}", offsetof(Model, {v.field}), {_ROLES[v.role]}, {number(v.start)}, '
        f"{number(v.low)}, {number(v.high)}}}"
        for v in listed
    )
    neutral_c = "\n".join(
        f"    m->c[{index}] = {number(float(value))};" for index, value in enumerate(neutral()) if value != 0.0
    )
    return f"""\
/* {title}
   Written by `board51 export-model` from the kernels of the twin; (N) is equation N of T. Tkacik, A. Jadlovska,
   J. Jadlovsky, "Modeling, Identification and Validation of the Modified Magnetic Levitation Model". */
#include "model.h"
#include <math.h>
#include <string.h>

{functions(rig.program)}
const Variable variables[VARIABLES] = {{
{rows}
}};

void model_reset(Model *m)
{{
    int n;
    memset(m, 0, sizeof *m);
{neutral_c}
    for (n = 0; n < VARIABLES; n += 1) {{
        *(double *)((char *)m + variables[n].place) = variables[n].start;
    }}
    m->closed_loop = 1;
}}

void model_begin(Model *m)
{{
{_delays(rig)}    memset(m->memory, 0, sizeof m->memory);
    simulate_begin(m, m->memory, m->i_start, m->x_start, m->v_start, m->u_start);
    m->memory[{X_BEFORE}] = m->memory[{X_READ}];
    m->memory[{INTEGRAL}] = 0.0;
    m->u = m->u_start;
}}

void model_tick(Model *m)
{{
    const Results tick = loop_advance(m, m->memory, m->closed_loop, m->x_ref, m->u_c);
    m->u = tick.v[3];
}}
"""


def _delays(rig: Rig) -> str:
    if not rig.delays:
        return ""
    lines = [
        f"    const Results act = simulate_delay_in_ticks(m->c[{ACT}]);",
        f"    const Results sense = simulate_delay_in_ticks(m->c[{SENSE}]);",
    ]
    for name in ("act", "sense"):
        lines += [f"    m->{name}_whole = (int){name}.v[0];", f"    m->{name}_part_s = {name}.v[1];"]
    return "\n".join([*lines, ""])
