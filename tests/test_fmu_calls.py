"""Which call is allowed when, what it does, and what the log says."""

import ctypes
import gc
import math
import threading
from ctypes import byref, c_double, c_int, c_size_t, c_uint, c_void_p

import pytest
from fmu_fixture import FORCE, GAIN, POSITION, PULL, SPARE, STEPS, WISH
from fmu_importer import (
    DISCARD,
    DO_STEP_STATUS,
    ENVIRONMENT,
    ERROR,
    LAST_SUCCESSFUL_TIME,
    OK,
    PENDING_STATUS,
    TERMINATED,
    Instance,
)

from tissue_contact import status

MODES = ("instantiated", "initialization", "step", "failed", "terminated")


def in_mode(fmu, mode):
    """An instance in one of MODES, at time 0."""
    made = Instance(fmu)
    if mode == "initialization":
        assert (made.setup(), made.enter()) == (OK, OK)
    elif mode != "instantiated":
        made.start()
    if mode == "failed":
        made.set({WISH: float(status.SUBSTEP_BUDGET)})
        assert made.step(0.0, 0.1) == DISCARD
        made.set({WISH: 0.0})
    if mode == "terminated":
        assert made.call("fmi2Terminate") == OK
    made.messages.clear()
    return made


def status_call(name, kind, value):
    return lambda i: i.call(name, c_int(kind), byref(value))


def with_state(action):
    """A call that needs a saved state."""

    def run(i):
        state = i.save()
        try:
            return action(i, state)
        finally:
            i.drop(state)

    return run


EMPTY = (None, c_size_t(0), None)

# Function -> (call, modes it is allowed in): table of FMI 2.0, section 4.2.4, with the freedoms that
# c/calls.def names.
ANY = set(MODES)
STEPPING = {"step", "failed"}
AFTER = STEPPING | {"terminated"}
SETTABLE = ANY - {"terminated"}
TABLE = {
    "fmi2SetDebugLogging": (lambda i: i.debug(True), ANY),
    "fmi2SetupExperiment": (lambda i: i.setup(), {"instantiated"}),
    "fmi2EnterInitializationMode": (lambda i: i.enter(), {"instantiated"}),
    "fmi2ExitInitializationMode": (lambda i: i.exit(), {"initialization"}),
    "fmi2Terminate": (lambda i: i.call("fmi2Terminate"), STEPPING),
    "fmi2Reset": (lambda i: i.call("fmi2Reset"), ANY),
    "fmi2GetReal": (lambda i: i.get(POSITION, PULL)[0], ANY),
    "fmi2GetInteger": (lambda i: i.call("fmi2GetInteger", *EMPTY), ANY),
    "fmi2GetBoolean": (lambda i: i.call("fmi2GetBoolean", *EMPTY), ANY),
    "fmi2GetString": (lambda i: i.call("fmi2GetString", *EMPTY), ANY),
    "fmi2SetReal": (lambda i: i.set({PULL: 0.5}), SETTABLE),
    "fmi2SetInteger": (lambda i: i.call("fmi2SetInteger", *EMPTY), SETTABLE),
    "fmi2SetBoolean": (lambda i: i.call("fmi2SetBoolean", *EMPTY), SETTABLE),
    "fmi2SetString": (lambda i: i.call("fmi2SetString", *EMPTY), SETTABLE),
    "fmi2GetFMUstate": (with_state(lambda i, s: OK), ANY),
    "fmi2SetFMUstate": (with_state(lambda i, s: i.restore(s)), ANY),
    "fmi2FreeFMUstate": (lambda i: i.drop(i.save()), ANY),
    "fmi2SerializedFMUstateSize": (
        with_state(lambda i, s: i.call("fmi2SerializedFMUstateSize", s, byref(c_size_t()))),
        ANY,
    ),
    "fmi2SerializeFMUstate": (with_state(lambda i, s: len(i.serialize(s)) * 0), ANY),
    "fmi2DeSerializeFMUstate": (with_state(lambda i, s: i.deserialize(i.serialize(s))[0]), ANY),
    "fmi2DoStep": (lambda i: i.step(0.0, 0.1), STEPPING),
    "fmi2GetStatus": (status_call("fmi2GetStatus", DO_STEP_STATUS, c_int()), AFTER),
    "fmi2GetRealStatus": (status_call("fmi2GetRealStatus", LAST_SUCCESSFUL_TIME, c_double()), AFTER),
    "fmi2GetBooleanStatus": (status_call("fmi2GetBooleanStatus", TERMINATED, c_int()), AFTER),
}

# Declared absent in modelDescription.xml, or for model exchange: never allowed, never a crash.
NOTHING = (None, c_size_t(0), None, None)
ABSENT = {
    "fmi2CancelStep": (),
    "fmi2GetDirectionalDerivative": (None, c_size_t(0), None, c_size_t(0), None, None),
    "fmi2SetRealInputDerivatives": NOTHING,
    "fmi2GetRealOutputDerivatives": NOTHING,
    "fmi2EnterEventMode": (),
    "fmi2NewDiscreteStates": (None,),
    "fmi2EnterContinuousTimeMode": (),
    "fmi2CompletedIntegratorStep": (c_int(0), None, None),
    "fmi2SetTime": (c_double(0),),
    "fmi2SetContinuousStates": (None, c_size_t(0)),
    "fmi2GetDerivatives": (None, c_size_t(0)),
    "fmi2GetEventIndicators": (None, c_size_t(0)),
    "fmi2GetContinuousStates": (None, c_size_t(0)),
    "fmi2GetNominalsOfContinuousStates": (None, c_size_t(0)),
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("function", TABLE)
def test_call_is_allowed_exactly_where_the_table_says(fmu, function, mode):
    call, modes = TABLE[function]
    made = in_mode(fmu, mode)
    state = made.save()
    before = made.serialize(state)
    made.drop(state)
    if mode in modes:
        assert call(made) == OK, made.text
        assert made.messages == []
    else:
        assert call(made) == ERROR
        assert f"{function} may not be called" in made.text
        state = made.save()
        assert made.serialize(state) == before, "a refused call changed the state"
        made.drop(state)
    made.free()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("function", ABSENT)
def test_absent_function_refuses_everywhere(fmu, function, mode):
    made = in_mode(fmu, mode)
    assert made.call(function, *ABSENT[function]) == ERROR
    assert made.text.startswith(f"{function}: ")
    made.free()


@pytest.mark.parametrize("function", [*TABLE, *ABSENT])
def test_null_instance_is_an_error(fmu, function):
    call = getattr(fmu.native, function)
    assert call(None, *[c_size_t(0)] * 8) == ERROR


def test_every_function_is_in_a_table_of_these_tests():
    from tissue_contact.fmu.check import fmi_functions

    rest = {"fmi2GetTypesPlatform", "fmi2GetVersion", "fmi2Instantiate", "fmi2FreeInstance"}
    pending = {"fmi2GetIntegerStatus", "fmi2GetStringStatus"}
    assert set(TABLE) | set(ABSENT) | rest | pending == fmi_functions()


def test_version_and_platform(fmu):
    assert fmu.native.fmi2GetVersion() == b"2.0"
    assert fmu.native.fmi2GetTypesPlatform() == b"default"


def test_free_of_null_is_nothing(fmu):
    fmu.native.fmi2FreeInstance(None)


# --- values -------------------------------------------------------------------------------------------------


def test_start_values_can_be_read_at_once(instance):
    assert instance.get(PULL, POSITION, GAIN, SPARE) == (OK, [0.25, 0.5, 2.0, 0.125])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_nonfinite_value_changes_nothing_and_is_named(instance, bad):
    instance.start()
    assert instance.set({GAIN: 5.0, PULL: bad}) == ERROR
    assert "tool.pull" in instance.text
    assert instance.get(GAIN, PULL) == (OK, [2.0, 0.25])


@pytest.mark.parametrize("value", [0.999, 1.0000001e7, -1.0])
def test_parameter_outside_its_bounds_is_refused(instance, value):
    assert instance.set({PULL: 0.5, GAIN: value}) == ERROR
    assert "contact.stiffness" in instance.text and "[1, 1e+07]" in instance.text
    assert f"{value:.17g}" in instance.text
    assert instance.get(PULL, GAIN) == (OK, [0.25, 2.0])


def test_bounds_themselves_are_allowed(instance):
    assert instance.set({GAIN: 1.0}) == OK
    assert instance.set({GAIN: 1e7}) == OK


def test_output_cannot_be_set(instance):
    assert instance.set({PULL: 0.5, FORCE: 1.0}) == ERROR
    assert "tool.force[1] is an output" in instance.text
    assert instance.value(PULL) == 0.25


@pytest.mark.parametrize("reference", [7, 2**32 - 1])
def test_unknown_reference_is_refused(instance, reference):
    assert instance.set({PULL: 0.5, reference: 1.0}) == ERROR
    assert str(reference) in instance.text
    assert instance.get(PULL, reference)[0] == ERROR
    assert instance.value(PULL) == 0.25


def test_null_vectors(instance):
    for name in ("fmi2GetReal", "fmi2SetReal"):
        assert instance.call(name, None, c_size_t(1), None) == ERROR
        assert instance.call(name, None, c_size_t(0), None) == OK


@pytest.mark.parametrize("kind", ["Integer", "Boolean", "String"])
def test_there_are_only_reals(instance, kind):
    for verb in ("Get", "Set"):
        assert instance.call(f"fmi2{verb}{kind}", (c_uint * 1)(0), c_size_t(1), (c_void_p * 1)()) == ERROR
        assert f"fmi2{verb}{kind}" in instance.text


def test_outputs_follow_inputs_in_initialization_mode(instance):
    assert (instance.setup(), instance.enter()) == (OK, OK)
    for pull, gain in ((1.0, 3.0), (2.0, 4.0), (1.0, 3.0)):
        assert instance.set({PULL: pull, GAIN: gain}) == OK
        assert instance.get(POSITION, FORCE) == (OK, [gain * (0.5 + pull), gain * pull])
    assert instance.exit() == OK
    assert instance.get(POSITION, FORCE) == (OK, [4.5, 3.0])


def test_failed_initialization_names_the_variable_and_can_be_mended(instance):
    assert (instance.setup(), instance.enter()) == (OK, OK)
    assert instance.set({WISH: float(status.NONFINITE_INPUT)}) == OK
    assert instance.get(POSITION) == (ERROR, [-99.0])
    assert instance.exit() == ERROR
    assert "tool.wish: input slot 1 is 1: every input must be finite" in instance.text
    assert instance.set({WISH: 0.0}) == OK
    assert instance.exit() == OK
    assert instance.value(POSITION) == 1.5


def test_get_after_set_without_a_step_gives_the_last_outputs(instance):
    instance.start()
    assert instance.set({PULL: 9.0, GAIN: 7.0}) == OK
    assert instance.get(POSITION, PULL, GAIN) == (OK, [1.5, 9.0, 7.0])


def test_tunable_parameter_takes_effect_with_the_next_step(instance):
    instance.start()
    assert instance.set({GAIN: 100.0, PULL: 0.25}) == OK
    assert instance.value(FORCE) == 0.5
    assert instance.step(0.0, 0.1) == OK
    assert instance.value(FORCE) == 25.0


# --- failed steps -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("entry", status.STATUSES[1:], ids=lambda s: s.name)
def test_failed_step_leaves_the_state_and_says_why(instance, entry):
    instance.start()
    assert instance.step(0.0, 0.1) == OK
    kept = instance.get(POSITION, FORCE, STEPS)
    assert instance.set({WISH: float(entry.code)}) == OK
    assert instance.step(0.1, 0.1) == (DISCARD if entry.discard else ERROR)
    if not entry.discard:
        assert (entry.message % (1, entry.code)) in instance.text
    assert instance.get(POSITION, FORCE, STEPS) == kept
    assert instance.time() == 0.1
    value = c_int(-1)
    assert instance.call("fmi2GetBooleanStatus", c_int(TERMINATED), byref(value)) == OK
    assert value.value == 0
    assert instance.call("fmi2GetStatus", c_int(DO_STEP_STATUS), byref(value)) == OK
    assert value.value == (DISCARD if entry.discard else ERROR)
    assert instance.set({WISH: 0.0}) == OK
    assert instance.step(0.1, 0.1) == OK
    assert instance.value(STEPS) == 2.0


def test_unknown_status_is_reported(instance):
    instance.start()
    instance.set({WISH: 77.0})
    assert instance.step(0.0, 0.1) == ERROR
    assert "unknown status 77" in instance.text


def test_parameter_slot_is_named(instance):
    instance.start()
    instance.set({WISH: float(status.PARAMETER_RANGE)})
    assert instance.step(0.0, 0.1) == ERROR
    assert "contact.damping: parameter slot 1 is 3" in instance.text


@pytest.mark.parametrize(
    "name",
    [
        "fmi2GetStatus",
        "fmi2GetRealStatus",
        "fmi2GetIntegerStatus",
        "fmi2GetBooleanStatus",
        "fmi2GetStringStatus",
    ],
)
def test_status_of_a_kind_that_is_not_there_is_discarded(instance, name):
    instance.start()
    value = c_void_p()
    assert instance.call(name, c_int(PENDING_STATUS), byref(value)) == DISCARD
    assert instance.messages == []  # a discarded call is told in debug logging only


# --- log ----------------------------------------------------------------------------------------------------


def test_message_goes_to_the_callers_environment_as_finished_text(fmu):
    made = Instance(fmu, name="50% of #1", logging_on=True)
    assert made.set({99: 1.0}) == ERROR
    for environment, name, kind, category, text, finished in made.messages:
        assert environment == ENVIRONMENT
        assert name == b"50% of #1"
        assert text == b"%s"
        assert not finished.endswith(b"\n") and finished
        assert (kind, category) in {(OK, b"logEvents"), (ERROR, b"logStatusError")}
    made.free()


def test_hash_sign_is_doubled(instance):
    assert instance.debug(True, "log#1") == ERROR
    assert 'no log category "log##1"' in instance.text


def log_of_three(made):
    """Categories told by a wrong call, a discarded call and an initialization."""
    made.messages.clear()
    made.set({99: 1.0})
    made.start()
    made.call("fmi2GetStringStatus", c_int(PENDING_STATUS), byref(c_void_p()))
    return {m[3].decode() for m in made.messages}


def test_errors_are_told_without_debug_logging(fmu):
    made = Instance(fmu, logging_on=False)
    assert log_of_three(made) == {"logStatusError"}
    made.free()


@pytest.mark.parametrize(
    ("on", "categories", "told"),
    [
        (True, (), {"logStatusError", "logStatusDiscard", "logEvents"}),
        (True, ("logAll",), {"logStatusError", "logStatusDiscard", "logEvents"}),
        (True, ("logEvents",), {"logEvents"}),
        (True, ("logStatusDiscard", "logStatusError"), {"logStatusError", "logStatusDiscard"}),
        (False, (), set()),
        (False, ("logEvents",), set()),
    ],
)
def test_categories(instance, on, categories, told):
    assert instance.debug(on, *categories) == OK
    assert log_of_three(instance) == told


def test_unknown_category_changes_nothing(instance):
    assert instance.debug(True, "logEvents", "logNonsense") == ERROR
    assert "logNonsense" in instance.text
    assert log_of_three(instance) == {"logStatusError"}


def test_declared_categories_are_those_that_can_be_set(fmu, instance):
    from lxml import etree

    root = etree.parse(fmu.directory / "modelDescription.xml")
    declared = [c.get("name") for c in root.iter("Category")]
    assert declared
    assert instance.debug(True, *declared) == OK


def test_no_logger_is_survived(fmu):
    made = Instance(fmu, logger=False, logging_on=True)
    assert made.c
    assert made.set({99: 1.0}) == ERROR
    made.start()
    made.free()


# --- life ---------------------------------------------------------------------------------------------------


def test_reset_restores_everything(fmu):
    made = Instance(fmu, logging_on=False)
    state = made.save()
    fresh = made.serialize(state)
    made.drop(state)
    made.debug(True)
    made.set({PULL: 3.0, GAIN: 50.0})
    made.start(2.0, 5.0)
    for k in range(3):
        assert made.step(2.0 + k * 0.5, 0.5) == OK
    assert made.call("fmi2Reset") == OK
    state = made.save()
    assert made.serialize(state) == fresh
    made.drop(state)
    assert (made.enter(), made.exit()) == (OK, OK)
    assert made.time() == 0.0
    assert made.step(0.0, 100.0) == OK, "the stop time of the last experiment was not forgotten"
    assert made.call("fmi2Reset") == OK
    assert log_of_three(made) == {"logStatusError"}, "debug logging was not reset"
    made.free()


def test_a_run_after_reset_equals_the_first(instance):
    def run():
        instance.start()
        out = []
        for k in range(50):
            instance.set({PULL: math.sin(k)})
            assert instance.step(k * 0.01, 0.01) == OK
            out.append(instance.get(POSITION, FORCE, STEPS))
        return out

    first = run()
    assert instance.call("fmi2Reset") == OK
    assert run() == first


@pytest.mark.parametrize("name", [None, "", "  "])
def test_instance_needs_a_name(fmu, name):
    made = Instance(fmu, name=name)
    assert made.c is None
    assert "needs a name" in made.text


def test_model_exchange_is_refused(fmu):
    made = Instance(fmu, kind=0)
    assert made.c is None
    assert "co-simulation only" in made.text


def test_no_callbacks_is_no_crash(fmu):
    args = (b"one", c_int(1), fmu.guid.encode(), fmu.location.encode(), None, c_int(0), c_int(0))
    assert fmu.native.fmi2Instantiate(*args) is None


def test_instances_do_not_touch_each_other(fmu):
    one, two = Instance(fmu, name="one").start(), Instance(fmu, name="two").start()
    one.set({PULL: 1.0})
    for k in range(10):
        assert one.step(k * 0.1, 0.1) == OK
        if k < 3:
            assert two.step(k * 0.1, 0.1) == OK
    assert (one.value(STEPS), two.value(STEPS)) == (10.0, 3.0)
    one.free()
    assert two.step(0.3, 0.1) == OK
    alone = Instance(fmu).start()
    for k in range(4):
        alone.step(k * 0.1, 0.1)
    assert two.get(POSITION, FORCE) == alone.get(POSITION, FORCE)
    two.free()
    alone.free()


def test_a_thread_for_each_instance(fmu):
    def run(seed, out):
        made = Instance(fmu, name=f"thread {seed}").start()
        for k in range(2000):
            made.set({PULL: math.sin(seed + k)})
            made.step(k * 1e-3, 1e-3)
        out[seed] = made.get(POSITION, FORCE, STEPS)
        made.free()

    alone, together = {}, {}
    for seed in range(2):
        run(seed, alone)
    threads = [threading.Thread(target=run, args=(seed, together)) for seed in range(2)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert alone == together


class Heap(ctypes.Structure):
    """struct mallinfo2 of glibc."""

    _fields_ = tuple(
        (name, c_size_t) for name in ["arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks"]
    ) + (
        ("uordblks", c_size_t),
        ("fordblks", c_size_t),
        ("keepcost", c_size_t),
    )


def heap_bytes():
    """Bytes that malloc has given out and not got back; Python's small objects lie elsewhere."""
    call = ctypes.CDLL(None).mallinfo2
    call.restype = Heap
    gc.collect()
    heap = call()
    return heap.uordblks + heap.hblkhd


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallinfo2"), reason="needs glibc 2.33")
def test_ten_thousand_instances_leak_nothing(fmu):
    def live_and_die(times):
        for _ in range(times):
            made = Instance(fmu)
            made.start()
            state = made.save()
            content = made.serialize(state)
            _, second = made.deserialize(content)
            made.drop(state)
            made.drop(second)
            made.step(0.0, 0.1)
            made.free()
            assert Instance(fmu, guid="{wrong}").c is None

    live_and_die(100)  # let Python make its caches
    before = heap_bytes()
    live_and_die(10_000)
    assert heap_bytes() - before < 10_000, "a byte or more an instance was not freed"
