"""A machine as an FMU for co-simulation, FMI 3.0 or 2.0, around its C header: no Python inside.

The archive has the sources and, where a C compiler is at hand, the binary of this system.
"""

from __future__ import annotations

import io
import platform
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
from importlib.resources import files
from pathlib import Path
from xml.sax.saxutils import quoteattr

from ident.errors import IdentError
from ident.export.c import CLOSURES, EFFECTS, SMOOTH, header, symbol
from ident.export.c_print import constant
from ident.export.equations import Equations
from ident.export.laws import DRIVES, Vocabulary
from ident.export.target import Job, Product, Target, translated
from ident.files import version

# a drive is outside: its torque is the input
TORQUES = {kind: word for kind, word in EFFECTS.items() if kind not in DRIVES}
WORDS = Vocabulary(TORQUES, CLOSURES, degree=7)
STAMP = (2020, 1, 1, 0, 0, 0)  # range: of every file in the archive, so that equal ones are equal
STEP = 1e-3  # range: [s] that the description proposes
NAMESPACE = uuid.UUID("6f1d2c1e-7f0b-4c39-9d55-0b1c6f0e1a11")  # range: of tokens of equal models
FMI3_STATUS = """
EXPORTED const char *fmi3GetVersion(void) { return "3.0"; }
EXPORTED void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *path,
    int visible, int logging, int events, int early, const unsigned int *required, size_t n,
    void *environment, void *log, void *update)
{
    (void)name; (void)token; (void)path; (void)visible; (void)logging; (void)events; (void)early;
    (void)required; (void)n; (void)environment; (void)log; (void)update;
    return make();
}
EXPORTED void *fmi3InstantiateModelExchange(void) { return NULL; }
EXPORTED void *fmi3InstantiateScheduledExecution(void) { return NULL; }
EXPORTED void fmi3FreeInstance(void *m) { free(m); }
EXPORTED int fmi3SetDebugLogging(void) { return 0; }
EXPORTED int fmi3EnterInitializationMode(void *m, int has_tolerance, double tolerance, double start,
    int has_stop, double stop)
{
    (void)has_tolerance; (void)tolerance; (void)has_stop; (void)stop;
    ((Instance *)m)->time = start;
    return 0;
}
EXPORTED int fmi3ExitInitializationMode(void *m) { return begin((Instance *)m); }
EXPORTED int fmi3EnterEventMode(void) { return 0; }
EXPORTED int fmi3EnterStepMode(void) { return 0; }
EXPORTED int fmi3EnterConfigurationMode(void) { return 0; }
EXPORTED int fmi3ExitConfigurationMode(void) { return 0; }
EXPORTED int fmi3Terminate(void) { return 0; }
EXPORTED int fmi3Reset(void *m) { reset((Instance *)m); return 0; }
EXPORTED int fmi3GetFloat64(void *m, const unsigned int vr[], size_t n, double x[], size_t values)
{
    (void)values;
    return get((Instance *)m, vr, n, x);
}
EXPORTED int fmi3SetFloat64(void *m, const unsigned int vr[], size_t n, const double x[],
    size_t values)
{
    (void)values;
    return set((Instance *)m, vr, n, x);
}
EXPORTED int fmi3GetFMUState(void *m, void **s)
{
    if (!*s) *s = malloc(sizeof(Instance));
    if (!*s) return 3;
    memcpy(*s, m, sizeof(Instance));
    return 0;
}
EXPORTED int fmi3SetFMUState(void *m, void *s) { memcpy(m, s, sizeof(Instance)); return 0; }
EXPORTED int fmi3FreeFMUState(void *m, void **s) { (void)m; free(*s); *s = NULL; return 0; }
EXPORTED int fmi3SerializedFMUStateSize(void *m, void *s, size_t *n)
{
    (void)m; (void)s;
    *n = sizeof(Instance);
    return 0;
}
EXPORTED int fmi3SerializeFMUState(void *m, void *s, unsigned char b[], size_t n)
{
    (void)m;
    if (n < sizeof(Instance)) return 3;
    memcpy(b, s, sizeof(Instance));
    return 0;
}
EXPORTED int fmi3DeserializeFMUState(void *m, const unsigned char b[], size_t n, void **s)
{
    (void)m;
    if (n < sizeof(Instance)) return 3;
    if (!*s) *s = malloc(sizeof(Instance));
    if (!*s) return 3;
    memcpy(*s, b, sizeof(Instance));
    return 0;
}
EXPORTED int fmi3DoStep(void *m, double now, double step, int no_set, int *event, int *terminate,
    int *early, double *last)
{
    (void)no_set;
    *event = *terminate = *early = 0;
    {
        const int status = move((Instance *)m, now, step);
        *last = ((Instance *)m)->time;
        return status;
    }
}
"""
FMI3_ABSENT = [
    *(f"{verb}{kind}" for verb in ("Get", "Set")
      for kind in ("Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64",
                   "UInt64", "Boolean", "String", "Binary", "Clock", "IntervalDecimal",
                   "IntervalFraction", "ShiftDecimal", "ShiftFraction")),
    "GetNumberOfVariableDependencies", "GetVariableDependencies", "GetDirectionalDerivative",
    "GetAdjointDerivative", "EvaluateDiscreteStates", "UpdateDiscreteStates",
    "EnterContinuousTimeMode", "CompletedIntegratorStep", "SetTime", "SetContinuousStates",
    "GetContinuousStateDerivatives", "GetEventIndicators", "GetContinuousStates",
    "GetNominalsOfContinuousStates", "GetNumberOfEventIndicators", "GetNumberOfContinuousStates",
    "GetOutputDerivatives", "ActivateModelPartition",
]  # fmt: skip
FMI2_STATUS = """
EXPORTED const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORTED const char *fmi2GetVersion(void) { return "2.0"; }
EXPORTED void *fmi2Instantiate(const char *name, int type, const char *token, const char *path,
    const void *functions, int visible, int logging)
{
    (void)name; (void)type; (void)token; (void)path; (void)functions; (void)visible; (void)logging;
    return make();
}
EXPORTED void fmi2FreeInstance(void *m) { free(m); }
EXPORTED int fmi2SetDebugLogging(void) { return 0; }
EXPORTED int fmi2SetupExperiment(void *m, int has_tolerance, double tolerance, double start,
    int has_stop, double stop)
{
    (void)has_tolerance; (void)tolerance; (void)has_stop; (void)stop;
    ((Instance *)m)->time = start;
    return 0;
}
EXPORTED int fmi2EnterInitializationMode(void) { return 0; }
EXPORTED int fmi2ExitInitializationMode(void *m) { return begin((Instance *)m); }
EXPORTED int fmi2Terminate(void) { return 0; }
EXPORTED int fmi2Reset(void *m) { reset((Instance *)m); return 0; }
EXPORTED int fmi2GetReal(void *m, const unsigned int vr[], size_t n, double x[])
{
    return get((Instance *)m, vr, n, x);
}
EXPORTED int fmi2SetReal(void *m, const unsigned int vr[], size_t n, const double x[])
{
    return set((Instance *)m, vr, n, x);
}
EXPORTED int fmi2DoStep(void *m, double now, double step, int no_set)
{
    (void)no_set;
    return move((Instance *)m, now, step);
}
EXPORTED int fmi2GetFMUstate(void *m, void **s)
{
    if (!*s) *s = malloc(sizeof(Instance));
    if (!*s) return 3;
    memcpy(*s, m, sizeof(Instance));
    return 0;
}
EXPORTED int fmi2SetFMUstate(void *m, void *s) { memcpy(m, s, sizeof(Instance)); return 0; }
EXPORTED int fmi2FreeFMUstate(void *m, void **s) { (void)m; free(*s); *s = NULL; return 0; }
"""
FMI2_ABSENT = [
    *(f"{verb}{kind}" for verb in ("Get", "Set") for kind in ("Integer", "Boolean", "String")),
    "SerializedFMUstateSize", "SerializeFMUstate", "DeSerializeFMUstate",
    "GetDirectionalDerivative", "SetRealInputDerivatives", "GetRealOutputDerivatives",
    "CancelStep", "GetStatus", "GetRealStatus", "GetIntegerStatus", "GetBooleanStatus",
    "GetStringStatus",
]  # fmt: skip
PLATFORMS = {
    "linux": ("linux", ".so"),
    "darwin": ("darwin", ".dylib"),
    "win32": ("windows", ".dll"),
}


def write(job: Job) -> Product:
    """Return the archive of a job."""
    fmi, real = job.settings.get("fmi", 3), str(job.settings.get("real", "double"))
    if fmi not in (2, 3):
        raise IdentError(f"fmi = {fmi!r}; valid: 2, 3")
    translation = translated(job, WORDS)
    equations, name = Equations(translation, SMOOTH), symbol(job.out.stem)
    sources = {
        f"{name}.h": header(equations, name, real),
        f"{name}.c": _source(equations, name, real, int(fmi)),
    }
    token = str(uuid.uuid5(NAMESPACE, f"{fmi}{''.join(sources.values())}"))
    describe = _description3 if fmi == 3 else _description2
    inside: dict[str, bytes] = {
        "modelDescription.xml": describe(equations, name, token, job.step or STEP).encode(),
        **{f"sources/{file}": text.encode() for file, text in sources.items()},
    }
    if fmi == 3:
        inside["sources/buildDescription.xml"] = (
            '<?xml version="1.0" encoding="UTF-8"?>\n<fmiBuildDescription fmiVersion="3.0">\n'
            f'  <BuildConfiguration modelIdentifier="{name}">\n'
            f'    <SourceFileSet language="C99"><SourceFile name="{name}.c"/></SourceFileSet>\n'
            "  </BuildConfiguration>\n</fmiBuildDescription>\n"
        ).encode()
    notes = []
    place, suffix = _platform(int(fmi))
    binary = _compiled(sources, name, suffix)
    if binary is None:
        notes.append("no C compiler here, so the FMU has sources and no binary: install gcc")
    else:
        inside[f"binaries/{place}/{name}{suffix}"] = binary
    return Product({job.out.name: _zipped(inside)}, translation, tuple(notes))


def _platform(fmi: int) -> tuple[str, str]:
    """Return the folder of binaries of this system, and their suffix."""
    system, suffix = PLATFORMS.get(sys.platform, ("linux", ".so"))
    if fmi == 2:
        return {"windows": "win64"}.get(system, f"{system}64"), suffix
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(
        platform.machine().lower(), platform.machine().lower()
    )
    return f"{machine}-{system}", suffix


def _source(equations: Equations, name: str, real: str, fmi: int) -> str:
    text = (files("ident.export") / "fmi_wrapper.c").read_text(encoding="utf-8")
    part, absent = (FMI3_STATUS, FMI3_ABSENT) if fmi == 3 else (FMI2_STATUS, FMI2_ABSENT)
    stubs = "".join(f"EXPORTED int fmi{fmi}{x}(void) {{ return 3; }}\n" for x in absent)
    exported = (
        "#if defined(_WIN32)\n#define EXPORTED __declspec(dllexport)\n#else\n"
        '#define EXPORTED __attribute__((visibility("default")))\n#endif'
    )
    start = ", ".join(constant(x, real) for x in _start(equations))
    text = text.replace("#define EXPORTED", exported).replace("VERSION_PART", part + stubs)
    return text.replace("START", start).replace("NAME", name).replace("REAL", real)


def _start(equations: Equations) -> list[float]:
    machine = equations.machine
    links = [machine.by_joint[name] for name in equations.independent]
    return [float(machine.start[link.joint.index]) - link.offset for link in links]


def _compiled(sources: dict[str, str], name: str, suffix: str) -> bytes | None:
    """Return the shared library, None without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc") or shutil.which("clang")
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        done = subprocess.run(
            [compiler, "-std=c99", "-O2", "-shared", "-fPIC", "-fvisibility=hidden", "-o",
             f"{name}{suffix}", f"{name}.c", "-lm"],
            cwd=folder, capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode:
            raise IdentError(f"{compiler} fails: {' '.join(done.stderr.split())[:300]}")
        return (folder / f"{name}{suffix}").read_bytes()


def _zipped(inside: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, data in inside.items():
            archive.writestr(zipfile.ZipInfo(path, STAMP), data, zipfile.ZIP_DEFLATED)
    return stream.getvalue()


def _variables(equations: Equations) -> list[tuple[str, str, str, str, float | None, str]]:
    """Return name, causality, variability, initial, start and unit, by reference from 1."""
    machine, starts = equations.machine, _start(equations)
    joints = [machine.by_joint[name].joint for name in equations.independent]
    rows: list[tuple[str, str, str, str, float | None, str]] = []
    for joint in joints:
        rows.append((f"tau.{joint.name}", "input", "continuous", "", 0.0, joint.force_unit))
    for joint, start in zip(joints, starts, strict=True):
        rows.append((f"q_start.{joint.name}", "parameter", "fixed", "exact", start, joint.unit))
    for joint in joints:
        unit = f"{joint.unit}/s"
        rows.append((f"v_start.{joint.name}", "parameter", "fixed", "exact", 0.0, unit))
    for word, per in (("q", ""), ("v", "/s")):
        for joint in joints:
            name = f"{word}.{joint.name}"
            rows.append((name, "output", "continuous", "calculated", None, joint.unit + per))
    return rows


UNITS = {
    "rad": 'rad="1"', "m": 'm="1"', "rad/s": 'rad="1" s="-1"', "m/s": 'm="1" s="-1"',
    "N m": 'kg="1" m="2" s="-2"', "N": 'kg="1" m="1" s="-2"',
}  # fmt: skip


def _units(rows: list[tuple[str, str, str, str, float | None, str]]) -> str:
    units = dict.fromkeys(row[5] for row in rows)
    lines = [
        f'    <Unit name="{unit}"><BaseUnit {UNITS[unit]}/></Unit>' for unit in units
    ]  # fmt: skip
    return "  <UnitDefinitions>\n" + "\n".join(lines) + "\n  </UnitDefinitions>\n"


def _description3(equations: Equations, name: str, token: str, step: float) -> str:
    rows, d = _variables(equations), len(equations.independent)
    lines = ['    <Float64 name="time" valueReference="0" causality="independent" '
             'variability="continuous"/>']  # fmt: skip
    for i, (word, causality, variability, initial, start, unit) in enumerate(rows, 1):
        more = f' initial="{initial}"' if initial else ""
        more += f' start="{start!r}"' if start is not None else ""
        lines.append(
            f'    <Float64 name={quoteattr(word)} valueReference="{i}" causality="{causality}" '
            f'variability="{variability}" unit="{unit}"{more}/>'
        )
    outputs = [3 * d + 1 + i for i in range(2 * d)]
    structure = [f'    <Output valueReference="{i}"/>' for i in outputs]
    structure += [
        f'    <InitialUnknown valueReference="{i}" dependencies="{i - 2 * d}" '
        'dependenciesKind="dependent"/>'
        for i in outputs
    ]
    newline = "\n"
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<fmiModelDescription fmiVersion="3.0" modelName={quoteattr(equations.machine.name)} '
        f'instantiationToken="{{{token}}}" generationTool="ident {version()}" '
        'variableNamingConvention="flat">\n'
        f'  <CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="true" '
        'canGetAndSetFMUState="true" canSerializeFMUState="true"/>\n'
        f"{_units(rows)}"
        f'  <DefaultExperiment startTime="0.0" stepSize="{step!r}"/>\n'
        f"  <ModelVariables>\n{newline.join(lines)}\n  </ModelVariables>\n"
        f"  <ModelStructure>\n{newline.join(structure)}\n  </ModelStructure>\n"
        "</fmiModelDescription>\n"
    )


def _description2(equations: Equations, name: str, token: str, step: float) -> str:
    rows, d = _variables(equations), len(equations.independent)
    lines = []
    for i, (word, causality, variability, initial, start, unit) in enumerate(rows, 1):
        more = f' initial="{initial}"' if initial else ""
        begin = f' start="{start!r}"' if start is not None else ""
        lines.append(
            f'    <ScalarVariable name={quoteattr(word)} valueReference="{i}" '
            f'causality="{causality}" variability="{variability}"{more}>'
            f'<Real unit="{unit}"{begin}/></ScalarVariable>'
        )
    outputs = [3 * d + 1 + i for i in range(2 * d)]
    known = [f'      <Unknown index="{i}"/>' for i in outputs]
    initial_unknowns = [f'      <Unknown index="{i}" dependencies="{i - 2 * d}"/>' for i in outputs]
    newline = "\n"
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<fmiModelDescription fmiVersion="2.0" modelName={quoteattr(equations.machine.name)} '
        f'guid="{{{token}}}" generationTool="ident {version()}" variableNamingConvention="flat">\n'
        f'  <CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="true" '
        f'canGetAndSetFMUstate="true">\n    <SourceFiles><File name="{name}.c"/></SourceFiles>\n'
        "  </CoSimulation>\n"
        f"{_units(rows)}"
        f'  <DefaultExperiment startTime="0.0" stepSize="{step!r}"/>\n'
        f"  <ModelVariables>\n{newline.join(lines)}\n  </ModelVariables>\n"
        f"  <ModelStructure>\n    <Outputs>\n{newline.join(known)}\n    </Outputs>\n"
        f"    <InitialUnknowns>\n{newline.join(initial_unknowns)}\n    </InitialUnknowns>\n"
        "  </ModelStructure>\n</fmiModelDescription>\n"
    )


FMU = Target("fmu", "an FMU for co-simulation", ".fmu", WORDS, write, settings=("real", "fmi"))
