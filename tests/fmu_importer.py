"""A bare importer: the functions of an FMU's library through ctypes, and what the logger was told."""

import ctypes
import zipfile
from ctypes import byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path

from lxml import etree

OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
DO_STEP_STATUS, PENDING_STATUS, LAST_SUCCESSFUL_TIME, TERMINATED = range(4)

LOGGER = ctypes.CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p, c_char_p)
ALLOCATE = ctypes.CFUNCTYPE(c_void_p, c_size_t, c_size_t)
FREE = ctypes.CFUNCTYPE(None, c_void_p)
FINISHED = ctypes.CFUNCTYPE(None, c_void_p, c_int)


class Callbacks(ctypes.Structure):
    """fmi2CallbackFunctions."""

    _fields_ = (
        ("logger", LOGGER),
        ("allocateMemory", ALLOCATE),
        ("freeMemory", FREE),
        ("stepFinished", FINISHED),
        ("componentEnvironment", c_void_p),
    )


ENVIRONMENT = 0x5EED  # stands for a pointer of the importer; an FMU must hand it back and not look behind it


class Unpacked:
    """An .fmu unpacked into a directory, its library loaded."""

    def __init__(self, path, directory):
        self.directory = Path(directory)
        with zipfile.ZipFile(path) as archive:
            archive.extractall(directory)
        root = etree.parse(self.directory / "modelDescription.xml").getroot()
        self.guid = root.get("guid")
        (library,) = (self.directory / "binaries").glob("*/*")
        self.native = ctypes.CDLL(str(library))
        self.native.fmi2Instantiate.restype = c_void_p
        self.native.fmi2FreeInstance.restype = None
        self.native.fmi2FreeInstance.argtypes = [c_void_p]
        self.native.fmi2GetVersion.restype = c_char_p
        self.native.fmi2GetTypesPlatform.restype = c_char_p

    @property
    def location(self):
        """The resources as a URI."""
        return (self.directory / "resources").as_uri()


class Instance:
    """One instance; methods return the status and never raise. ``messages`` holds what the logger got."""

    def __init__(self, fmu, name="one", guid=None, location="", logging_on=False, logger=True, kind=1):
        """``location`` is the resources as bytes or None; by default the right URI."""
        self.fmu, self.native, self.messages = fmu, fmu.native, []
        self._log = LOGGER(lambda *a: self.messages.append(a)) if logger else LOGGER()
        callbacks = Callbacks(logger=self._log, componentEnvironment=ENVIRONMENT)
        self.c = self.native.fmi2Instantiate(
            None if name is None else name.encode(),
            c_int(kind),
            (guid or fmu.guid).encode(),
            fmu.location.encode() if location == "" else location,
            byref(callbacks),
            c_int(0),
            c_int(logging_on),
        )
        # The structure may be gone after the call: an FMU must have copied it.
        ctypes.memset(byref(callbacks), 0xFF, ctypes.sizeof(callbacks))

    @property
    def text(self):
        """All texts that were logged, one a line."""
        return "\n".join(m[5].decode() for m in self.messages)

    def call(self, name, *arguments):
        """Call a function with ctypes arguments after the instance."""
        return getattr(self.native, name)(c_void_p(self.c), *arguments)

    def free(self):
        self.native.fmi2FreeInstance(self.c)
        self.c = None

    def debug(self, on, *categories):
        names = (c_char_p * len(categories))(*(c.encode() for c in categories))
        return self.call("fmi2SetDebugLogging", c_int(on), c_size_t(len(categories)), names)

    def setup(self, start=0.0, stop=None):
        defined = c_int(stop is not None)
        return self.call("fmi2SetupExperiment", c_int(0), c_double(0), c_double(start), defined, c_double(stop or 0.0))

    def enter(self):
        return self.call("fmi2EnterInitializationMode")

    def exit(self):
        return self.call("fmi2ExitInitializationMode")

    def start(self, start=0.0, stop=None):
        """Bring a fresh instance into Step Mode."""
        assert (self.setup(start, stop), self.enter(), self.exit()) == (OK, OK, OK), self.text
        return self

    def set(self, values):
        n = len(values)
        references, numbers = (c_uint * n)(*values), (c_double * n)(*values.values())
        return self.call("fmi2SetReal", references, c_size_t(n), numbers)

    def get(self, *references):
        n = len(references)
        numbers = (c_double * n)(*[-99.0] * n)
        status = self.call("fmi2GetReal", (c_uint * n)(*references), c_size_t(n), numbers)
        return status, list(numbers)

    def value(self, reference):
        status, (value,) = self.get(reference)
        assert status == OK, self.text
        return value

    def step(self, time, h):
        return self.call("fmi2DoStep", c_double(time), c_double(h), c_int(1))

    def time(self):
        value = c_double()
        assert self.call("fmi2GetRealStatus", c_int(LAST_SUCCESSFUL_TIME), byref(value)) == OK
        return value.value

    def save(self):
        state = c_void_p()
        assert self.call("fmi2GetFMUstate", byref(state)) == OK, self.text
        return state

    def restore(self, state):
        return self.call("fmi2SetFMUstate", state)

    def drop(self, state):
        return self.call("fmi2FreeFMUstate", byref(state))

    def serialize(self, state):
        size = c_size_t()
        assert self.call("fmi2SerializedFMUstateSize", state, byref(size)) == OK, self.text
        content = ctypes.create_string_buffer(size.value)
        assert self.call("fmi2SerializeFMUstate", state, content, size) == OK, self.text
        return content.raw

    def deserialize(self, content):
        state = c_void_p()
        return self.call("fmi2DeSerializeFMUstate", content, c_size_t(len(content)), byref(state)), state
