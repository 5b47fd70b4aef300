"""Descriptions of the nodes that are no field of a message: folders, properties, methods and their arguments.

Fields of the topics are described by the comments of board51.proto.
"""

from __future__ import annotations

FOLDERS = {
    "twin": "the simulated rig that runs beside the real one",
    "setpoint": "write here; each write is a command, through the limits of gateway and board",
    "link": "whether samples arrive",
    "alarms": "conditions that hold, or that nobody has acknowledged",
    "last_command": "the newest command to this rig, by any route",
    "Identification": "nameplate, as the board states it; empty where it states nothing",
}
PROPERTIES = {
    "EngineeringUnits": "unit of the value",
    "EURange": "range of the value in normal operation",
    "InstrumentRange": "range that the converter, or the board, can represent",
    "EnumStrings": "meaning of each number, from 0",
    "InputArguments": "arguments of the method",
    "OutputArguments": "results of the method",
}
METHODS = {
    "set_mode": "switch the mode of control",
    "set_reference": "set a new position of the ball, through the limits",
    "set_gains": "give the control law new gains and a new operating point",
    "excite": "play an excitation on the input or on the reference",
    "capture": "record the current at 25 kHz around a step of the input",
    "set_stream": "choose how many ticks are sent",
    "set_host_loss": "set the action of the board without its host",
    "stop": "switch the coil off at once; possible for everybody who has logged in",
    "ping": "ask the board for an answer; changes nothing",
    "mark": "write a remark into every log",
    "acknowledge": "acknowledge an alarm by its name",
}
ARGUMENTS = {
    "set_mode.mode": "the new mode",
    "set_reference.x_ref_m": "the new reference, m, up from the sensor",
    "set_gains.law": "the control law",
    "set_gains.i_0_a": "current at the operating point, A",
    "set_gains.x_0_m": "position at the operating point, m",
    "set_gains.u_0_v": "input at the operating point, V",
    "excite.period_s": "period; of a chirp the first period, s",
    "capture.u_from_v": "input before the step, V",
    "capture.u_to_v": "input after the step, V",
    "capture.duration_s": "length of the record, s",
    "set_stream.divider": "every n-th tick is sent",
    "set_host_loss.policy": "0 keep, 1 coil off, 2 hold",
    "set_host_loss.timeout_s": "time without its host until it acts, s",
    "mark.text": "the remark",
}
