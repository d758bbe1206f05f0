"""Broken mechanism.toml files: each is refused in one line: what, where, and what is right."""

from __future__ import annotations

import pytest

CLOSURE = '[[closure]]\nname = "ball"'
FRAME_A = 'a = { link = "crank", xyz = [0.0, 0.0, 0.08] }'
FRAME_B = 'b = { link = "rod", xyz = [0.0, 0.3, 0.0] }'
FRAMES = f"{FRAME_A}\n{FRAME_B}\n"
POINT = 'kind = "point"\n' + FRAMES + 'axes = "xyz"'
LINEAR = 'kind = "linear"\njoints = ["theta", "s"]\nratios = [1.0, 2.0]'
UNKNOWN = '["rod.Ixx", "rod.Iyy", "rod.Izz"]'
BASIS = 'basis = "free"'
END = "[multipliers]"
TWICE = f'[[closure]]\nname = "ball"\nkind = "point"\n{FRAMES}'


def effect(*lines: str) -> str:
    return "\n".join(["[[effect]]", *lines, "", END])


def log(entry: str) -> str:
    return f"[log]\n{entry}\n{END}"


# part of the slider-crank's mechanism.toml, what stands there instead, and words of the message
EDITS = {
    "no TOML": ("[joints]", "[joints", ("TOML", "line 5")),
    "value missing": ('kind = "point"', "kind =", ("TOML", "line 11")),
    "a key twice": ('kind = "point"', 'kind = "point"\nkind = "point"', ("TOML", "line 12")),
    "not UTF-8": ("[joints]", "# \udcff\n[joints]", ("line 5", "0xff", "UTF-8")),
    "unknown top key": ("gravity =", "gravty =", ("'gravty'", "did you mean 'gravity'?")),
    "unknown table": ("[multipliers]", "[multiplier]", ("did you mean 'multipliers'?",)),
    "unknown joints key": ("passive =", "pasive =", ("[joints]", "did you mean 'passive'?")),
    "unknown closure key": ("axes =", "axis =", ("closure 1 ('ball')", "did you mean 'axes'?")),
    "unknown frame key": ("a = { link", "a = { lnk", ("'ball'", "did you mean 'link'?")),
    "unknown parameters key": ("unknown =", "unkown =", ("did you mean 'unknown'?",)),
    "unknown multipliers key": ("basis =", "bases =", ("did you mean 'basis'?",)),
    "no urdf": ("urdf = ", "# ", ("'urdf'", "write urdf =")),
    "urdf that is not there": ('"slider_crank.urdf"', '"crank.urdf"', ("'crank.urdf'", "no such")),
    "urdf a number": ('"slider_crank.urdf"', "3", ("urdf = 3", "text in quotes")),
    "urdf a folder": ('"slider_crank.urdf"', '"."', ("urdf = '.'", "no such file")),
    "gravity of two": ("[0.0, 0.0, -9.81]", "[0.0, -9.81]", ("gravity", "3 finite numbers")),
    "gravity a number": ("[0.0, 0.0, -9.81]", "9.81", ("gravity = 9.81", "3 finite numbers")),
    "gravity with text": ("[0.0, 0.0, -9.81]", '[0, 0, "g"]', ("gravity", "3 finite numbers")),
    "gravity NaN": ("[0.0, 0.0, -9.81]", "[0, 0, nan]", ("gravity", "3 finite numbers")),
    "joints a list": ("[joints]", "[[joints]]", ("[joints]", "table")),
    "closure a table": ("[[closure]]", "[closure]", ("[[closure]]",)),
    "parameters a list": ("[parameters]", "[[parameters]]", ("[parameters]", "table")),
    "passive a text": ('["alpha", "beta"]', '"alpha"', ("passive = 'alpha'", "list of texts")),
    "passive of numbers": ('["alpha", "beta"]', "[1, 2]", ("passive", "list of texts")),
    "passive unknown": ('["alpha", "beta"]', '["alfa"]', ("'alfa'", "did you mean 'alpha'?")),
    "start unknown": ("alpha = 1.1", "alfa = 1.1", ("start", "did you mean 'alpha'?")),
    "start in words": ("theta = 0.0", 'theta = "0"', ("start", "theta = '0'", "finite number")),
    "closure without name": (CLOSURE, "[[closure]]", ("closure 1", "'name'")),
    "closure without kind": ('kind = "point"', "", ("closure 1", "'kind'")),
    "closure of unknown kind": ('"point"', '"pont"', ("'pont'", "did you mean 'point'?")),
    "closure on unknown link": ('link = "rod"', 'link = "rd"', ("no link 'rd'", "'rod'", "world")),
    "closure without a": (FRAME_A, "", ("'ball'", "a = { link")),
    "frame a text": (FRAME_A, 'a = "crank"', ("a = 'crank'", "a = { link")),
    "frame without link": ('link = "rod", ', "", ("'ball'", "b: ", "'link'")),
    "xyz of two": ("[0.0, 0.3, 0.0]", "[0.0, 0.3]", ("xyz", "3 finite numbers")),
    "axes unknown": ('axes = "xyz"', 'axes = "xw"', ("axes = 'xw'", "letters xyz")),
    "axes twice": ('axes = "xyz"', 'axes = "xx"', ("axes = 'xx'", "letters xyz")),
    "axes empty": ('axes = "xyz"', 'axes = ""', ("axes", "text in quotes")),
    "axes of a revolute": ('kind = "point"', 'kind = "revolute"', ("unknown key 'axes'",)),
    "distance without length": (POINT, 'kind = "distance"\n' + FRAMES, ("length", "above 0")),
    "negative length": (POINT, f'kind = "distance"\nlength = -1\n{FRAMES}', ("length", "above 0")),
    "linear of one": (POINT, LINEAR.replace(', "s"', ""), ("1 joints and 2 ratios", "two or more")),
    "linear counts": (POINT, LINEAR.replace(", 2.0", ""), ("2 joints and 1 ratios", "one ratio")),
    "linear joint twice": (POINT, LINEAR.replace('"s"', '"theta"'), ("two or more different",)),
    "linear joint unknown": (POINT, LINEAR.replace('"theta"', '"teta"'), ("mean 'theta'?",)),
    "linear ratio zero": (POINT, LINEAR.replace("2.0", "0.0"), ("ratio of 0", "ratios")),
    "linear without ratios": (POINT, LINEAR.split("\nratios")[0], ("ratios", "finite numbers")),
    "linear never zero": (POINT, LINEAR + "\noffset = inf", ("offset", "finite number")),
    "two closures of one name": (
        "[parameters]",
        TWICE + "[parameters]",
        ("two closures", "'ball'"),
    ),
    "unknown a text": (UNKNOWN, '"rod"', ("unknown = 'rod'", "list of texts")),
    "unknown link": (UNKNOWN, '["rood.Ixx"]', ("'rood'", "did you mean 'rod'?")),
    "unknown parameter": (UNKNOWN, '["rod.Iww"]', ("rod", "no parameter 'Iww'", "Ixx")),
    "basis unknown": (BASIS, 'basis = "linaer"', ("[multipliers]", "did you mean 'linear'?")),
    "basis without spacing": (BASIS, 'basis = "linear"', ("'linear'", "spacing above 0 s")),
    "spacing negative": (BASIS, 'basis = "cubic"\nspacing = -1', ("spacing above 0 s", "-1")),
    "spacing in words": (BASIS, 'basis = "cubic"\nspacing = "5 ms"', ("5 ms", "finite number")),
    "log a number": (END, log('"t" = 3'), ('[log] "t"', "column =")),
    "log entry without column": (END, log('"t" = { scale = 2.0 }'), ('[log] "t"', "'column'")),
    "log key unknown": (END, log('"t" = { column = "t", gain = 2 }'), ("'gain'", "scale")),
    "log scale zero": (END, log('"t" = { column = "t", scale = 0 }'), ("scale = 0",)),
    "log scale in words": (END, log('"t" = { column = "t", scale = "ms" }'), ("finite number",)),
    "log not quoted": (END, log('tau.theta = { column = "i" }'), ("[log]", "theta")),
    "effect without kind": (END, effect('joint = "theta"'), ("effect 1", "'kind'")),
    "effect without joint": (END, effect('kind = "viscous"'), ("effect 1", "'joint'")),
    "effect of unknown kind": (
        END,
        effect('kind = "viscos"', 'joint = "s"'),
        ("effect 1", "did you mean 'viscous'?"),
    ),
    "effect of unknown joint": (
        END,
        effect('kind = "viscous"', 'joint = "tetha"'),
        ("effect 1", "no joint 'tetha'", "theta"),
    ),
    "effect parameter unknown": (
        END,
        effect('kind = "viscous"', 'joint = "s"', "fv = 1.0"),
        ("effect 1", "'fv'", "valid: Fv"),
    ),
    "effect value in words": (
        END,
        effect('kind = "viscous"', 'joint = "s"', 'Fv = "1"'),
        ("effect 1", "Fv = '1'", "finite number"),
    ),
    "effect of two joints": (
        END,
        effect('kind = "viscous"', 'joint = "s,theta"'),
        ("effect 1", "1 joint", "viscous:joint"),
    ),
    "effect twice": (
        END,
        effect('kind = "viscous"', 'joint = "s"', "[[effect]]", 'kind = "viscous"', 'joint = "s"'),
        ("effect 2", "viscous:s", "already"),
    ),
    "loop that cannot close": (
        FRAME_B,
        'b = { link = "rod", xyz = [0, 0.01, 0] }',
        ("start", "ball"),
    ),
}


@pytest.mark.usefixtures("short_search")
@pytest.mark.parametrize(("old", "new", "words"), EDITS.values(), ids=EDITS)
def test_mechanisms_with_one_fault(old, new, words, slider, change, refused):
    file = slider / "mechanism.toml"
    text = file.read_text()
    assert old in text
    file.write_bytes(text.replace(old, new, 1).encode(errors="surrogateescape"))
    where = "slider_crank" if "start" in words else "mechanism.toml"
    refused((where, *words), "check", slider)


@pytest.mark.parametrize(
    ("make", "words"),
    {
        "not there": (lambda path: None, ("no such file", ".urdf")),
        "folder without toml": (lambda path: path.mkdir(), ("no mechanism.toml", "URDF")),
        "other suffix": (lambda path: path.write_text("urdf"), ("mechanism.toml", ".urdf")),
    }.values(),
    ids=["not there", "folder without toml", "other suffix"],
)
def test_what_is_no_mechanism(make, words, tmp_path, refused):
    make(tmp_path / "robot")
    refused(("robot", *words), "check", tmp_path / "robot")


def test_a_link_fixed_to_another_has_no_parameters_of_its_own(arm, refused):
    toml = arm.with_name("mechanism.toml")
    toml.write_text('urdf = "arm.urdf"\n[parameters]\nunknown = ["tool.m"]\n')
    refused(("mechanism.toml", "tool", "fixed", "valid: fore, upper"), "check", toml)


FUNCTION = 'kind = "function"\nfile = "phi.py"\nfunction = "phi"'
CODE = {
    "missing": (None, ("phi.py", "no such file")),
    "raises": ("raise RuntimeError('one\\ntwo')", ("phi.py", "RuntimeError", "one two")),
    "no Python": ("def phi(", ("phi.py", "SyntaxError")),
    "leaves": ("raise SystemExit(7)", ("phi.py", "SystemExit")),
    "no such function": ("def psi(q):\n    return q[0]", ("phi.py", "no function 'phi'")),
    "no function": ("phi = 3", ("phi.py", "no function 'phi'")),
}
CALLED = {
    "unknown joint": ("def phi(q):\n    return q['elbow']", ("elbow", "alpha, beta, theta")),
    "returns a text": ("def phi(q):\n    return 'zero'", ("returned 'zero'", "CasADi")),
    "returns nothing": ("def phi(q):\n    pass", ("returned None", "CasADi")),
    "returns other symbols": (
        "import casadi\ndef phi(q):\n    return casadi.SX.sym('x')",
        ("symbols of its own (x)", "joints"),
    ),
    "wrong arguments": ("def phi(a, b):\n    return a", ("argument", "CasADi")),
}


@pytest.mark.parametrize(("code", "words"), CODE.values(), ids=CODE)
def test_closure_functions(code, words, slider, change, refused):
    change(slider / "mechanism.toml", POINT, FUNCTION)
    if code is not None:
        (slider / "phi.py").write_text(code)
    refused(("mechanism.toml", *words), "check", slider, "--allow-code")


@pytest.mark.parametrize(("code", "words"), CALLED.values(), ids=CALLED)
def test_closure_functions_when_called(code, words, slider, change, refused):
    change(slider / "mechanism.toml", POINT, FUNCTION)
    (slider / "phi.py").write_text(code)
    refused(("closure 'ball'", *words), "check", slider, "--allow-code")


def test_code_is_run_only_where_it_is_allowed(slider, change, refused):
    change(slider / "mechanism.toml", POINT, FUNCTION)
    (slider / "phi.py").write_text("print('I ran')")
    refused(("mechanism.toml", "phi.py", "--allow-code"), "check", slider)
