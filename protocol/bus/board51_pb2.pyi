from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Mode(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    MODE_IDLE: _ClassVar[Mode]
    MODE_OPEN_LOOP: _ClassVar[Mode]
    MODE_CLOSED_LOOP: _ClassVar[Mode]

class Law(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    LAW_LQI: _ClassVar[Law]
    LAW_PID: _ClassVar[Law]

class Shape(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SHAPE_NONE: _ClassVar[Shape]
    SHAPE_STEP: _ClassVar[Shape]
    SHAPE_RECTANGLE: _ClassVar[Shape]
    SHAPE_SAWTOOTH: _ClassVar[Shape]
    SHAPE_PRBS: _ClassVar[Shape]
    SHAPE_MULTISINE: _ClassVar[Shape]
    SHAPE_CHIRP: _ClassVar[Shape]
MODE_IDLE: Mode
MODE_OPEN_LOOP: Mode
MODE_CLOSED_LOOP: Mode
LAW_LQI: Law
LAW_PID: Law
SHAPE_NONE: Shape
SHAPE_STEP: Shape
SHAPE_RECTANGLE: Shape
SHAPE_SAWTOOTH: Shape
SHAPE_PRBS: Shape
SHAPE_MULTISINE: Shape
SHAPE_CHIRP: Shape

class State(_message.Message):
    __slots__ = ("sequence", "tick", "session", "host_time_ns", "i_c_a", "x_m", "u_c_v", "x_ref_m", "mode", "flags", "t_s", "lost_before")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TICK_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    HOST_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    I_C_A_FIELD_NUMBER: _ClassVar[int]
    X_M_FIELD_NUMBER: _ClassVar[int]
    U_C_V_FIELD_NUMBER: _ClassVar[int]
    X_REF_M_FIELD_NUMBER: _ClassVar[int]
    MODE_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    T_S_FIELD_NUMBER: _ClassVar[int]
    LOST_BEFORE_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    tick: int
    session: int
    host_time_ns: int
    i_c_a: float
    x_m: float
    u_c_v: float
    x_ref_m: float
    mode: Mode
    flags: int
    t_s: float
    lost_before: int
    def __init__(self, sequence: _Optional[int] = ..., tick: _Optional[int] = ..., session: _Optional[int] = ..., host_time_ns: _Optional[int] = ..., i_c_a: _Optional[float] = ..., x_m: _Optional[float] = ..., u_c_v: _Optional[float] = ..., x_ref_m: _Optional[float] = ..., mode: _Optional[_Union[Mode, str]] = ..., flags: _Optional[int] = ..., t_s: _Optional[float] = ..., lost_before: _Optional[int] = ...) -> None: ...

class StateBatch(_message.Message):
    __slots__ = ("states",)
    STATES_FIELD_NUMBER: _ClassVar[int]
    states: _containers.RepeatedCompositeFieldContainer[State]
    def __init__(self, states: _Optional[_Iterable[_Union[State, _Mapping]]] = ...) -> None: ...

class Parameters(_message.Message):
    __slots__ = ("session", "host_time_ns", "firmware", "board_id", "protocol_version", "sample_time_s", "law", "gains", "i_0_a", "x_0_m", "u_0_v", "x_ref_min_m", "x_ref_max_m", "x_ref_step_max_m", "x_ref_slew_m_s", "u_max_v", "stream_divider", "host_loss_policy", "host_loss_timeout_s", "i_lsb_a", "x_lsb_m", "u_lsb_v", "u_min_v", "from_tick", "capture_s", "gateway_x_ref_min_m", "gateway_x_ref_max_m")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    HOST_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    FIRMWARE_FIELD_NUMBER: _ClassVar[int]
    BOARD_ID_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_VERSION_FIELD_NUMBER: _ClassVar[int]
    SAMPLE_TIME_S_FIELD_NUMBER: _ClassVar[int]
    LAW_FIELD_NUMBER: _ClassVar[int]
    GAINS_FIELD_NUMBER: _ClassVar[int]
    I_0_A_FIELD_NUMBER: _ClassVar[int]
    X_0_M_FIELD_NUMBER: _ClassVar[int]
    U_0_V_FIELD_NUMBER: _ClassVar[int]
    X_REF_MIN_M_FIELD_NUMBER: _ClassVar[int]
    X_REF_MAX_M_FIELD_NUMBER: _ClassVar[int]
    X_REF_STEP_MAX_M_FIELD_NUMBER: _ClassVar[int]
    X_REF_SLEW_M_S_FIELD_NUMBER: _ClassVar[int]
    U_MAX_V_FIELD_NUMBER: _ClassVar[int]
    STREAM_DIVIDER_FIELD_NUMBER: _ClassVar[int]
    HOST_LOSS_POLICY_FIELD_NUMBER: _ClassVar[int]
    HOST_LOSS_TIMEOUT_S_FIELD_NUMBER: _ClassVar[int]
    I_LSB_A_FIELD_NUMBER: _ClassVar[int]
    X_LSB_M_FIELD_NUMBER: _ClassVar[int]
    U_LSB_V_FIELD_NUMBER: _ClassVar[int]
    U_MIN_V_FIELD_NUMBER: _ClassVar[int]
    FROM_TICK_FIELD_NUMBER: _ClassVar[int]
    CAPTURE_S_FIELD_NUMBER: _ClassVar[int]
    GATEWAY_X_REF_MIN_M_FIELD_NUMBER: _ClassVar[int]
    GATEWAY_X_REF_MAX_M_FIELD_NUMBER: _ClassVar[int]
    session: int
    host_time_ns: int
    firmware: str
    board_id: int
    protocol_version: int
    sample_time_s: float
    law: Law
    gains: _containers.RepeatedScalarFieldContainer[float]
    i_0_a: float
    x_0_m: float
    u_0_v: float
    x_ref_min_m: float
    x_ref_max_m: float
    x_ref_step_max_m: float
    x_ref_slew_m_s: float
    u_max_v: float
    stream_divider: int
    host_loss_policy: int
    host_loss_timeout_s: float
    i_lsb_a: float
    x_lsb_m: float
    u_lsb_v: float
    u_min_v: float
    from_tick: int
    capture_s: float
    gateway_x_ref_min_m: float
    gateway_x_ref_max_m: float
    def __init__(self, session: _Optional[int] = ..., host_time_ns: _Optional[int] = ..., firmware: _Optional[str] = ..., board_id: _Optional[int] = ..., protocol_version: _Optional[int] = ..., sample_time_s: _Optional[float] = ..., law: _Optional[_Union[Law, str]] = ..., gains: _Optional[_Iterable[float]] = ..., i_0_a: _Optional[float] = ..., x_0_m: _Optional[float] = ..., u_0_v: _Optional[float] = ..., x_ref_min_m: _Optional[float] = ..., x_ref_max_m: _Optional[float] = ..., x_ref_step_max_m: _Optional[float] = ..., x_ref_slew_m_s: _Optional[float] = ..., u_max_v: _Optional[float] = ..., stream_divider: _Optional[int] = ..., host_loss_policy: _Optional[int] = ..., host_loss_timeout_s: _Optional[float] = ..., i_lsb_a: _Optional[float] = ..., x_lsb_m: _Optional[float] = ..., u_lsb_v: _Optional[float] = ..., u_min_v: _Optional[float] = ..., from_tick: _Optional[int] = ..., capture_s: _Optional[float] = ..., gateway_x_ref_min_m: _Optional[float] = ..., gateway_x_ref_max_m: _Optional[float] = ...) -> None: ...

class Event(_message.Message):
    __slots__ = ("host_time_ns", "tick", "session", "source", "severity", "name", "text")
    HOST_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    TICK_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    SEVERITY_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    host_time_ns: int
    tick: int
    session: int
    source: str
    severity: str
    name: str
    text: str
    def __init__(self, host_time_ns: _Optional[int] = ..., tick: _Optional[int] = ..., session: _Optional[int] = ..., source: _Optional[str] = ..., severity: _Optional[str] = ..., name: _Optional[str] = ..., text: _Optional[str] = ...) -> None: ...

class SetMode(_message.Message):
    __slots__ = ("mode",)
    MODE_FIELD_NUMBER: _ClassVar[int]
    mode: Mode
    def __init__(self, mode: _Optional[_Union[Mode, str]] = ...) -> None: ...

class SetReference(_message.Message):
    __slots__ = ("x_ref_m",)
    X_REF_M_FIELD_NUMBER: _ClassVar[int]
    x_ref_m: float
    def __init__(self, x_ref_m: _Optional[float] = ...) -> None: ...

class SetGains(_message.Message):
    __slots__ = ("law", "gains", "i_0_a", "x_0_m", "u_0_v")
    LAW_FIELD_NUMBER: _ClassVar[int]
    GAINS_FIELD_NUMBER: _ClassVar[int]
    I_0_A_FIELD_NUMBER: _ClassVar[int]
    X_0_M_FIELD_NUMBER: _ClassVar[int]
    U_0_V_FIELD_NUMBER: _ClassVar[int]
    law: Law
    gains: _containers.RepeatedScalarFieldContainer[float]
    i_0_a: float
    x_0_m: float
    u_0_v: float
    def __init__(self, law: _Optional[_Union[Law, str]] = ..., gains: _Optional[_Iterable[float]] = ..., i_0_a: _Optional[float] = ..., x_0_m: _Optional[float] = ..., u_0_v: _Optional[float] = ...) -> None: ...

class Excite(_message.Message):
    __slots__ = ("shape", "on_reference", "amplitude", "offset", "period_s", "period_end_s", "seed", "duration_s")
    SHAPE_FIELD_NUMBER: _ClassVar[int]
    ON_REFERENCE_FIELD_NUMBER: _ClassVar[int]
    AMPLITUDE_FIELD_NUMBER: _ClassVar[int]
    OFFSET_FIELD_NUMBER: _ClassVar[int]
    PERIOD_S_FIELD_NUMBER: _ClassVar[int]
    PERIOD_END_S_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    DURATION_S_FIELD_NUMBER: _ClassVar[int]
    shape: Shape
    on_reference: bool
    amplitude: float
    offset: float
    period_s: float
    period_end_s: float
    seed: int
    duration_s: float
    def __init__(self, shape: _Optional[_Union[Shape, str]] = ..., on_reference: _Optional[bool] = ..., amplitude: _Optional[float] = ..., offset: _Optional[float] = ..., period_s: _Optional[float] = ..., period_end_s: _Optional[float] = ..., seed: _Optional[int] = ..., duration_s: _Optional[float] = ...) -> None: ...

class Capture(_message.Message):
    __slots__ = ("u_from_v", "u_to_v", "duration_s", "pre_s")
    U_FROM_V_FIELD_NUMBER: _ClassVar[int]
    U_TO_V_FIELD_NUMBER: _ClassVar[int]
    DURATION_S_FIELD_NUMBER: _ClassVar[int]
    PRE_S_FIELD_NUMBER: _ClassVar[int]
    u_from_v: float
    u_to_v: float
    duration_s: float
    pre_s: float
    def __init__(self, u_from_v: _Optional[float] = ..., u_to_v: _Optional[float] = ..., duration_s: _Optional[float] = ..., pre_s: _Optional[float] = ...) -> None: ...

class SetStream(_message.Message):
    __slots__ = ("divider",)
    DIVIDER_FIELD_NUMBER: _ClassVar[int]
    divider: int
    def __init__(self, divider: _Optional[int] = ...) -> None: ...

class SetHostLoss(_message.Message):
    __slots__ = ("policy", "timeout_s")
    POLICY_FIELD_NUMBER: _ClassVar[int]
    TIMEOUT_S_FIELD_NUMBER: _ClassVar[int]
    policy: int
    timeout_s: float
    def __init__(self, policy: _Optional[int] = ..., timeout_s: _Optional[float] = ...) -> None: ...

class Stop(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Ping(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Acknowledge(_message.Message):
    __slots__ = ("alarm", "comment", "shelve_s")
    ALARM_FIELD_NUMBER: _ClassVar[int]
    COMMENT_FIELD_NUMBER: _ClassVar[int]
    SHELVE_S_FIELD_NUMBER: _ClassVar[int]
    alarm: str
    comment: str
    shelve_s: float
    def __init__(self, alarm: _Optional[str] = ..., comment: _Optional[str] = ..., shelve_s: _Optional[float] = ...) -> None: ...

class Plant(_message.Message):
    __slots__ = ("name", "mass_kg", "travel_m", "x_max_m", "gravity_m_s2", "ball_diameter_m")
    NAME_FIELD_NUMBER: _ClassVar[int]
    MASS_KG_FIELD_NUMBER: _ClassVar[int]
    TRAVEL_M_FIELD_NUMBER: _ClassVar[int]
    X_MAX_M_FIELD_NUMBER: _ClassVar[int]
    GRAVITY_M_S2_FIELD_NUMBER: _ClassVar[int]
    BALL_DIAMETER_M_FIELD_NUMBER: _ClassVar[int]
    name: str
    mass_kg: float
    travel_m: float
    x_max_m: float
    gravity_m_s2: float
    ball_diameter_m: float
    def __init__(self, name: _Optional[str] = ..., mass_kg: _Optional[float] = ..., travel_m: _Optional[float] = ..., x_max_m: _Optional[float] = ..., gravity_m_s2: _Optional[float] = ..., ball_diameter_m: _Optional[float] = ...) -> None: ...

class SetPlant(_message.Message):
    __slots__ = ("plant", "confirmed")
    PLANT_FIELD_NUMBER: _ClassVar[int]
    CONFIRMED_FIELD_NUMBER: _ClassVar[int]
    plant: Plant
    confirmed: bool
    def __init__(self, plant: _Optional[_Union[Plant, _Mapping]] = ..., confirmed: _Optional[bool] = ...) -> None: ...

class Mark(_message.Message):
    __slots__ = ("text",)
    TEXT_FIELD_NUMBER: _ClassVar[int]
    text: str
    def __init__(self, text: _Optional[str] = ...) -> None: ...

class Command(_message.Message):
    __slots__ = ("id", "who", "issued_ns", "role", "valid_s", "set_mode", "set_reference", "set_gains", "excite", "capture", "set_stream", "set_host_loss", "stop", "ping", "mark", "acknowledge", "set_plant")
    ID_FIELD_NUMBER: _ClassVar[int]
    WHO_FIELD_NUMBER: _ClassVar[int]
    ISSUED_NS_FIELD_NUMBER: _ClassVar[int]
    ROLE_FIELD_NUMBER: _ClassVar[int]
    VALID_S_FIELD_NUMBER: _ClassVar[int]
    SET_MODE_FIELD_NUMBER: _ClassVar[int]
    SET_REFERENCE_FIELD_NUMBER: _ClassVar[int]
    SET_GAINS_FIELD_NUMBER: _ClassVar[int]
    EXCITE_FIELD_NUMBER: _ClassVar[int]
    CAPTURE_FIELD_NUMBER: _ClassVar[int]
    SET_STREAM_FIELD_NUMBER: _ClassVar[int]
    SET_HOST_LOSS_FIELD_NUMBER: _ClassVar[int]
    STOP_FIELD_NUMBER: _ClassVar[int]
    PING_FIELD_NUMBER: _ClassVar[int]
    MARK_FIELD_NUMBER: _ClassVar[int]
    ACKNOWLEDGE_FIELD_NUMBER: _ClassVar[int]
    SET_PLANT_FIELD_NUMBER: _ClassVar[int]
    id: str
    who: str
    issued_ns: int
    role: str
    valid_s: float
    set_mode: SetMode
    set_reference: SetReference
    set_gains: SetGains
    excite: Excite
    capture: Capture
    set_stream: SetStream
    set_host_loss: SetHostLoss
    stop: Stop
    ping: Ping
    mark: Mark
    acknowledge: Acknowledge
    set_plant: SetPlant
    def __init__(self, id: _Optional[str] = ..., who: _Optional[str] = ..., issued_ns: _Optional[int] = ..., role: _Optional[str] = ..., valid_s: _Optional[float] = ..., set_mode: _Optional[_Union[SetMode, _Mapping]] = ..., set_reference: _Optional[_Union[SetReference, _Mapping]] = ..., set_gains: _Optional[_Union[SetGains, _Mapping]] = ..., excite: _Optional[_Union[Excite, _Mapping]] = ..., capture: _Optional[_Union[Capture, _Mapping]] = ..., set_stream: _Optional[_Union[SetStream, _Mapping]] = ..., set_host_loss: _Optional[_Union[SetHostLoss, _Mapping]] = ..., stop: _Optional[_Union[Stop, _Mapping]] = ..., ping: _Optional[_Union[Ping, _Mapping]] = ..., mark: _Optional[_Union[Mark, _Mapping]] = ..., acknowledge: _Optional[_Union[Acknowledge, _Mapping]] = ..., set_plant: _Optional[_Union[SetPlant, _Mapping]] = ...) -> None: ...

class CommandReply(_message.Message):
    __slots__ = ("id", "accepted", "refused_by", "reason", "text", "tick", "attempts", "repeat_until_ns")
    ID_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    REFUSED_BY_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    TICK_FIELD_NUMBER: _ClassVar[int]
    ATTEMPTS_FIELD_NUMBER: _ClassVar[int]
    REPEAT_UNTIL_NS_FIELD_NUMBER: _ClassVar[int]
    id: str
    accepted: bool
    refused_by: str
    reason: str
    text: str
    tick: int
    attempts: int
    repeat_until_ns: int
    def __init__(self, id: _Optional[str] = ..., accepted: _Optional[bool] = ..., refused_by: _Optional[str] = ..., reason: _Optional[str] = ..., text: _Optional[str] = ..., tick: _Optional[int] = ..., attempts: _Optional[int] = ..., repeat_until_ns: _Optional[int] = ...) -> None: ...

class CommandRecord(_message.Message):
    __slots__ = ("received_ns", "answered_ns", "command", "reply")
    RECEIVED_NS_FIELD_NUMBER: _ClassVar[int]
    ANSWERED_NS_FIELD_NUMBER: _ClassVar[int]
    COMMAND_FIELD_NUMBER: _ClassVar[int]
    REPLY_FIELD_NUMBER: _ClassVar[int]
    received_ns: int
    answered_ns: int
    command: Command
    reply: CommandReply
    def __init__(self, received_ns: _Optional[int] = ..., answered_ns: _Optional[int] = ..., command: _Optional[_Union[Command, _Mapping]] = ..., reply: _Optional[_Union[CommandReply, _Mapping]] = ...) -> None: ...

class CaptureRecord(_message.Message):
    __slots__ = ("host_time_ns", "session", "tick", "sample_time_s", "u_from_v", "u_to_v", "step_index", "i_c_a")
    HOST_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    TICK_FIELD_NUMBER: _ClassVar[int]
    SAMPLE_TIME_S_FIELD_NUMBER: _ClassVar[int]
    U_FROM_V_FIELD_NUMBER: _ClassVar[int]
    U_TO_V_FIELD_NUMBER: _ClassVar[int]
    STEP_INDEX_FIELD_NUMBER: _ClassVar[int]
    I_C_A_FIELD_NUMBER: _ClassVar[int]
    host_time_ns: int
    session: int
    tick: int
    sample_time_s: float
    u_from_v: float
    u_to_v: float
    step_index: int
    i_c_a: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, host_time_ns: _Optional[int] = ..., session: _Optional[int] = ..., tick: _Optional[int] = ..., sample_time_s: _Optional[float] = ..., u_from_v: _Optional[float] = ..., u_to_v: _Optional[float] = ..., step_index: _Optional[int] = ..., i_c_a: _Optional[_Iterable[float]] = ...) -> None: ...

class RawBytes(_message.Message):
    __slots__ = ("host_time_ns", "to_board", "data")
    HOST_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    TO_BOARD_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    host_time_ns: int
    to_board: bool
    data: bytes
    def __init__(self, host_time_ns: _Optional[int] = ..., to_board: _Optional[bool] = ..., data: _Optional[bytes] = ...) -> None: ...

class Status(_message.Message):
    __slots__ = ("host_time_ns", "link", "port", "uptime_s", "session", "samples_per_s", "samples", "samples_lost", "bad_frames", "bytes_received", "bytes_sent", "reconnects", "board_resets", "commands_accepted", "commands_refused", "commands_timed_out", "latency_p50_ms", "latency_p99_ms", "publish_queue_depth", "publish_dropped", "log_queue_depth", "log_dropped", "log_file", "log_bytes", "log_state", "line_load", "board_bad_frames", "board_overruns", "states", "states_ignored", "to_board", "unanswered_s", "last_stop_ns")
    class BadFramesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    class StatesIgnoredEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    HOST_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    LINK_FIELD_NUMBER: _ClassVar[int]
    PORT_FIELD_NUMBER: _ClassVar[int]
    UPTIME_S_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_PER_S_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_LOST_FIELD_NUMBER: _ClassVar[int]
    BAD_FRAMES_FIELD_NUMBER: _ClassVar[int]
    BYTES_RECEIVED_FIELD_NUMBER: _ClassVar[int]
    BYTES_SENT_FIELD_NUMBER: _ClassVar[int]
    RECONNECTS_FIELD_NUMBER: _ClassVar[int]
    BOARD_RESETS_FIELD_NUMBER: _ClassVar[int]
    COMMANDS_ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    COMMANDS_REFUSED_FIELD_NUMBER: _ClassVar[int]
    COMMANDS_TIMED_OUT_FIELD_NUMBER: _ClassVar[int]
    LATENCY_P50_MS_FIELD_NUMBER: _ClassVar[int]
    LATENCY_P99_MS_FIELD_NUMBER: _ClassVar[int]
    PUBLISH_QUEUE_DEPTH_FIELD_NUMBER: _ClassVar[int]
    PUBLISH_DROPPED_FIELD_NUMBER: _ClassVar[int]
    LOG_QUEUE_DEPTH_FIELD_NUMBER: _ClassVar[int]
    LOG_DROPPED_FIELD_NUMBER: _ClassVar[int]
    LOG_FILE_FIELD_NUMBER: _ClassVar[int]
    LOG_BYTES_FIELD_NUMBER: _ClassVar[int]
    LOG_STATE_FIELD_NUMBER: _ClassVar[int]
    LINE_LOAD_FIELD_NUMBER: _ClassVar[int]
    BOARD_BAD_FRAMES_FIELD_NUMBER: _ClassVar[int]
    BOARD_OVERRUNS_FIELD_NUMBER: _ClassVar[int]
    STATES_FIELD_NUMBER: _ClassVar[int]
    STATES_IGNORED_FIELD_NUMBER: _ClassVar[int]
    TO_BOARD_FIELD_NUMBER: _ClassVar[int]
    UNANSWERED_S_FIELD_NUMBER: _ClassVar[int]
    LAST_STOP_NS_FIELD_NUMBER: _ClassVar[int]
    host_time_ns: int
    link: str
    port: str
    uptime_s: float
    session: int
    samples_per_s: float
    samples: int
    samples_lost: int
    bad_frames: _containers.ScalarMap[str, int]
    bytes_received: int
    bytes_sent: int
    reconnects: int
    board_resets: int
    commands_accepted: int
    commands_refused: int
    commands_timed_out: int
    latency_p50_ms: float
    latency_p99_ms: float
    publish_queue_depth: int
    publish_dropped: int
    log_queue_depth: int
    log_dropped: int
    log_file: str
    log_bytes: int
    log_state: str
    line_load: float
    board_bad_frames: int
    board_overruns: int
    states: int
    states_ignored: _containers.ScalarMap[str, int]
    to_board: str
    unanswered_s: float
    last_stop_ns: int
    def __init__(self, host_time_ns: _Optional[int] = ..., link: _Optional[str] = ..., port: _Optional[str] = ..., uptime_s: _Optional[float] = ..., session: _Optional[int] = ..., samples_per_s: _Optional[float] = ..., samples: _Optional[int] = ..., samples_lost: _Optional[int] = ..., bad_frames: _Optional[_Mapping[str, int]] = ..., bytes_received: _Optional[int] = ..., bytes_sent: _Optional[int] = ..., reconnects: _Optional[int] = ..., board_resets: _Optional[int] = ..., commands_accepted: _Optional[int] = ..., commands_refused: _Optional[int] = ..., commands_timed_out: _Optional[int] = ..., latency_p50_ms: _Optional[float] = ..., latency_p99_ms: _Optional[float] = ..., publish_queue_depth: _Optional[int] = ..., publish_dropped: _Optional[int] = ..., log_queue_depth: _Optional[int] = ..., log_dropped: _Optional[int] = ..., log_file: _Optional[str] = ..., log_bytes: _Optional[int] = ..., log_state: _Optional[str] = ..., line_load: _Optional[float] = ..., board_bad_frames: _Optional[int] = ..., board_overruns: _Optional[int] = ..., states: _Optional[int] = ..., states_ignored: _Optional[_Mapping[str, int]] = ..., to_board: _Optional[str] = ..., unanswered_s: _Optional[float] = ..., last_stop_ns: _Optional[int] = ...) -> None: ...

class PlantCard(_message.Message):
    __slots__ = ("host_time_ns", "plant", "who", "stated_ns", "board")
    HOST_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    PLANT_FIELD_NUMBER: _ClassVar[int]
    WHO_FIELD_NUMBER: _ClassVar[int]
    STATED_NS_FIELD_NUMBER: _ClassVar[int]
    BOARD_FIELD_NUMBER: _ClassVar[int]
    host_time_ns: int
    plant: Plant
    who: str
    stated_ns: int
    board: str
    def __init__(self, host_time_ns: _Optional[int] = ..., plant: _Optional[_Union[Plant, _Mapping]] = ..., who: _Optional[str] = ..., stated_ns: _Optional[int] = ..., board: _Optional[str] = ...) -> None: ...

class TwinState(_message.Message):
    __slots__ = ("sequence", "tick", "session", "t_s", "i_c_a", "x_m", "v_m_s", "u_c_v", "x_ref_m", "sync", "bridged_ticks")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TICK_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    T_S_FIELD_NUMBER: _ClassVar[int]
    I_C_A_FIELD_NUMBER: _ClassVar[int]
    X_M_FIELD_NUMBER: _ClassVar[int]
    V_M_S_FIELD_NUMBER: _ClassVar[int]
    U_C_V_FIELD_NUMBER: _ClassVar[int]
    X_REF_M_FIELD_NUMBER: _ClassVar[int]
    SYNC_FIELD_NUMBER: _ClassVar[int]
    BRIDGED_TICKS_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    tick: int
    session: int
    t_s: float
    i_c_a: float
    x_m: float
    v_m_s: float
    u_c_v: float
    x_ref_m: float
    sync: str
    bridged_ticks: int
    def __init__(self, sequence: _Optional[int] = ..., tick: _Optional[int] = ..., session: _Optional[int] = ..., t_s: _Optional[float] = ..., i_c_a: _Optional[float] = ..., x_m: _Optional[float] = ..., v_m_s: _Optional[float] = ..., u_c_v: _Optional[float] = ..., x_ref_m: _Optional[float] = ..., sync: _Optional[str] = ..., bridged_ticks: _Optional[int] = ...) -> None: ...

class SignalDivergence(_message.Message):
    __slots__ = ("error", "normalised", "rolling_rmse", "rolling_mean", "fit_percent", "window_full")
    ERROR_FIELD_NUMBER: _ClassVar[int]
    NORMALISED_FIELD_NUMBER: _ClassVar[int]
    ROLLING_RMSE_FIELD_NUMBER: _ClassVar[int]
    ROLLING_MEAN_FIELD_NUMBER: _ClassVar[int]
    FIT_PERCENT_FIELD_NUMBER: _ClassVar[int]
    WINDOW_FULL_FIELD_NUMBER: _ClassVar[int]
    error: float
    normalised: float
    rolling_rmse: float
    rolling_mean: float
    fit_percent: float
    window_full: bool
    def __init__(self, error: _Optional[float] = ..., normalised: _Optional[float] = ..., rolling_rmse: _Optional[float] = ..., rolling_mean: _Optional[float] = ..., fit_percent: _Optional[float] = ..., window_full: _Optional[bool] = ...) -> None: ...

class Divergence(_message.Message):
    __slots__ = ("sequence", "tick", "session", "t_s", "sync", "x_m", "i_c_a", "u_c_v", "innovation_x_m", "innovation_i_c_a", "nis", "nis_mean", "bridged_ticks", "nis_on", "innovation_valid")
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    TICK_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    T_S_FIELD_NUMBER: _ClassVar[int]
    SYNC_FIELD_NUMBER: _ClassVar[int]
    X_M_FIELD_NUMBER: _ClassVar[int]
    I_C_A_FIELD_NUMBER: _ClassVar[int]
    U_C_V_FIELD_NUMBER: _ClassVar[int]
    INNOVATION_X_M_FIELD_NUMBER: _ClassVar[int]
    INNOVATION_I_C_A_FIELD_NUMBER: _ClassVar[int]
    NIS_FIELD_NUMBER: _ClassVar[int]
    NIS_MEAN_FIELD_NUMBER: _ClassVar[int]
    BRIDGED_TICKS_FIELD_NUMBER: _ClassVar[int]
    NIS_ON_FIELD_NUMBER: _ClassVar[int]
    INNOVATION_VALID_FIELD_NUMBER: _ClassVar[int]
    sequence: int
    tick: int
    session: int
    t_s: float
    sync: str
    x_m: SignalDivergence
    i_c_a: SignalDivergence
    u_c_v: SignalDivergence
    innovation_x_m: float
    innovation_i_c_a: float
    nis: float
    nis_mean: float
    bridged_ticks: int
    nis_on: float
    innovation_valid: bool
    def __init__(self, sequence: _Optional[int] = ..., tick: _Optional[int] = ..., session: _Optional[int] = ..., t_s: _Optional[float] = ..., sync: _Optional[str] = ..., x_m: _Optional[_Union[SignalDivergence, _Mapping]] = ..., i_c_a: _Optional[_Union[SignalDivergence, _Mapping]] = ..., u_c_v: _Optional[_Union[SignalDivergence, _Mapping]] = ..., innovation_x_m: _Optional[float] = ..., innovation_i_c_a: _Optional[float] = ..., nis: _Optional[float] = ..., nis_mean: _Optional[float] = ..., bridged_ticks: _Optional[int] = ..., nis_on: _Optional[float] = ..., innovation_valid: _Optional[bool] = ...) -> None: ...

class TwinBatch(_message.Message):
    __slots__ = ("states", "divergences")
    STATES_FIELD_NUMBER: _ClassVar[int]
    DIVERGENCES_FIELD_NUMBER: _ClassVar[int]
    states: _containers.RepeatedCompositeFieldContainer[TwinState]
    divergences: _containers.RepeatedCompositeFieldContainer[Divergence]
    def __init__(self, states: _Optional[_Iterable[_Union[TwinState, _Mapping]]] = ..., divergences: _Optional[_Iterable[_Union[Divergence, _Mapping]]] = ...) -> None: ...

class Alarm(_message.Message):
    __slots__ = ("host_time_ns", "tick", "session", "name", "active", "value", "threshold_on", "threshold_off", "text")
    HOST_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    TICK_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    ACTIVE_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    THRESHOLD_ON_FIELD_NUMBER: _ClassVar[int]
    THRESHOLD_OFF_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    host_time_ns: int
    tick: int
    session: int
    name: str
    active: bool
    value: float
    threshold_on: float
    threshold_off: float
    text: str
    def __init__(self, host_time_ns: _Optional[int] = ..., tick: _Optional[int] = ..., session: _Optional[int] = ..., name: _Optional[str] = ..., active: _Optional[bool] = ..., value: _Optional[float] = ..., threshold_on: _Optional[float] = ..., threshold_off: _Optional[float] = ..., text: _Optional[str] = ...) -> None: ...

class Acknowledgement(_message.Message):
    __slots__ = ("alarm", "who", "host_time_ns", "comment", "shelve_s")
    ALARM_FIELD_NUMBER: _ClassVar[int]
    WHO_FIELD_NUMBER: _ClassVar[int]
    HOST_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    COMMENT_FIELD_NUMBER: _ClassVar[int]
    SHELVE_S_FIELD_NUMBER: _ClassVar[int]
    alarm: str
    who: str
    host_time_ns: int
    comment: str
    shelve_s: float
    def __init__(self, alarm: _Optional[str] = ..., who: _Optional[str] = ..., host_time_ns: _Optional[int] = ..., comment: _Optional[str] = ..., shelve_s: _Optional[float] = ...) -> None: ...

class Alarms(_message.Message):
    __slots__ = ("host_time_ns", "active", "acknowledged")
    HOST_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    ACTIVE_FIELD_NUMBER: _ClassVar[int]
    ACKNOWLEDGED_FIELD_NUMBER: _ClassVar[int]
    host_time_ns: int
    active: _containers.RepeatedCompositeFieldContainer[Alarm]
    acknowledged: _containers.RepeatedCompositeFieldContainer[Acknowledgement]
    def __init__(self, host_time_ns: _Optional[int] = ..., active: _Optional[_Iterable[_Union[Alarm, _Mapping]]] = ..., acknowledged: _Optional[_Iterable[_Union[Acknowledgement, _Mapping]]] = ...) -> None: ...

class TwinAlarms(_message.Message):
    __slots__ = ("active", "host_time_ns")
    ACTIVE_FIELD_NUMBER: _ClassVar[int]
    HOST_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    active: _containers.RepeatedCompositeFieldContainer[Alarm]
    host_time_ns: int
    def __init__(self, active: _Optional[_Iterable[_Union[Alarm, _Mapping]]] = ..., host_time_ns: _Optional[int] = ...) -> None: ...

class UseModel(_message.Message):
    __slots__ = ("model_json",)
    MODEL_JSON_FIELD_NUMBER: _ClassVar[int]
    model_json: str
    def __init__(self, model_json: _Optional[str] = ...) -> None: ...

class TwinCommand(_message.Message):
    __slots__ = ("id", "who", "use_model")
    ID_FIELD_NUMBER: _ClassVar[int]
    WHO_FIELD_NUMBER: _ClassVar[int]
    USE_MODEL_FIELD_NUMBER: _ClassVar[int]
    id: str
    who: str
    use_model: UseModel
    def __init__(self, id: _Optional[str] = ..., who: _Optional[str] = ..., use_model: _Optional[_Union[UseModel, _Mapping]] = ...) -> None: ...

class TwinModel(_message.Message):
    __slots__ = ("session", "since_tick", "name", "model_json", "sha256", "who", "command_id", "host_time_ns")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    SINCE_TICK_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    MODEL_JSON_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    WHO_FIELD_NUMBER: _ClassVar[int]
    COMMAND_ID_FIELD_NUMBER: _ClassVar[int]
    HOST_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    session: int
    since_tick: int
    name: str
    model_json: str
    sha256: str
    who: str
    command_id: str
    host_time_ns: int
    def __init__(self, session: _Optional[int] = ..., since_tick: _Optional[int] = ..., name: _Optional[str] = ..., model_json: _Optional[str] = ..., sha256: _Optional[str] = ..., who: _Optional[str] = ..., command_id: _Optional[str] = ..., host_time_ns: _Optional[int] = ...) -> None: ...

class TwinDiagnosis(_message.Message):
    __slots__ = ("host_time_ns", "session", "tick", "cause", "value", "unit", "probability", "others", "since_ns", "for_s", "sentence")
    HOST_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    TICK_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    PROBABILITY_FIELD_NUMBER: _ClassVar[int]
    OTHERS_FIELD_NUMBER: _ClassVar[int]
    SINCE_NS_FIELD_NUMBER: _ClassVar[int]
    FOR_S_FIELD_NUMBER: _ClassVar[int]
    SENTENCE_FIELD_NUMBER: _ClassVar[int]
    host_time_ns: int
    session: int
    tick: int
    cause: str
    value: float
    unit: str
    probability: float
    others: _containers.RepeatedScalarFieldContainer[str]
    since_ns: int
    for_s: float
    sentence: str
    def __init__(self, host_time_ns: _Optional[int] = ..., session: _Optional[int] = ..., tick: _Optional[int] = ..., cause: _Optional[str] = ..., value: _Optional[float] = ..., unit: _Optional[str] = ..., probability: _Optional[float] = ..., others: _Optional[_Iterable[str]] = ..., since_ns: _Optional[int] = ..., for_s: _Optional[float] = ..., sentence: _Optional[str] = ...) -> None: ...

class LogRequest(_message.Message):
    __slots__ = ("part", "from_byte", "block", "have")
    PART_FIELD_NUMBER: _ClassVar[int]
    FROM_BYTE_FIELD_NUMBER: _ClassVar[int]
    BLOCK_FIELD_NUMBER: _ClassVar[int]
    HAVE_FIELD_NUMBER: _ClassVar[int]
    part: str
    from_byte: int
    block: LogBlock
    have: bytes
    def __init__(self, part: _Optional[str] = ..., from_byte: _Optional[int] = ..., block: _Optional[_Union[LogBlock, _Mapping]] = ..., have: _Optional[bytes] = ...) -> None: ...

class LogPart(_message.Message):
    __slots__ = ("name", "bytes", "changed_ns")
    NAME_FIELD_NUMBER: _ClassVar[int]
    BYTES_FIELD_NUMBER: _ClassVar[int]
    CHANGED_NS_FIELD_NUMBER: _ClassVar[int]
    name: str
    bytes: int
    changed_ns: int
    def __init__(self, name: _Optional[str] = ..., bytes: _Optional[int] = ..., changed_ns: _Optional[int] = ...) -> None: ...

class LogBlock(_message.Message):
    __slots__ = ("stream", "session", "number", "count", "digest", "last_ns", "end_byte")
    STREAM_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    DIGEST_FIELD_NUMBER: _ClassVar[int]
    LAST_NS_FIELD_NUMBER: _ClassVar[int]
    END_BYTE_FIELD_NUMBER: _ClassVar[int]
    stream: str
    session: int
    number: int
    count: int
    digest: int
    last_ns: int
    end_byte: int
    def __init__(self, stream: _Optional[str] = ..., session: _Optional[int] = ..., number: _Optional[int] = ..., count: _Optional[int] = ..., digest: _Optional[int] = ..., last_ns: _Optional[int] = ..., end_byte: _Optional[int] = ...) -> None: ...

class LogRecord(_message.Message):
    __slots__ = ("key", "time_ns", "data")
    KEY_FIELD_NUMBER: _ClassVar[int]
    TIME_NS_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    key: str
    time_ns: int
    data: bytes
    def __init__(self, key: _Optional[str] = ..., time_ns: _Optional[int] = ..., data: _Optional[bytes] = ...) -> None: ...

class LogReply(_message.Message):
    __slots__ = ("now_ns", "parts", "blocks", "records", "more", "problem")
    NOW_NS_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    BLOCKS_FIELD_NUMBER: _ClassVar[int]
    RECORDS_FIELD_NUMBER: _ClassVar[int]
    MORE_FIELD_NUMBER: _ClassVar[int]
    PROBLEM_FIELD_NUMBER: _ClassVar[int]
    now_ns: int
    parts: _containers.RepeatedCompositeFieldContainer[LogPart]
    blocks: _containers.RepeatedCompositeFieldContainer[LogBlock]
    records: _containers.RepeatedCompositeFieldContainer[LogRecord]
    more: bool
    problem: str
    def __init__(self, now_ns: _Optional[int] = ..., parts: _Optional[_Iterable[_Union[LogPart, _Mapping]]] = ..., blocks: _Optional[_Iterable[_Union[LogBlock, _Mapping]]] = ..., records: _Optional[_Iterable[_Union[LogRecord, _Mapping]]] = ..., more: _Optional[bool] = ..., problem: _Optional[str] = ...) -> None: ...
