"""Finished models of the gallery and of real machines: their first line, and MuJoCo's compiler.

    python benchmarks/finished.py [--data DIR]… [NAME …]

Each machine's model is grown with the defaults. A row has the first line that `ident grow` prints,
whether that line states the fall of the error, and whether MuJoCo compiles the `identified.urdf`
that the last fit writes. Names are URDFs of gallery.py and machines of machines.py; where these are
searched is said there.
"""

from __future__ import annotations

import argparse
import importlib
import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import mujoco
from gallery import HIDDEN, with_hidden
from lxml import etree
from machines import SHARED, Machine, located
from robots import by_pinocchio, log_of, urdfs

import ident
from ident.assess.diagnosis import assess_growth
from ident.show.headline import headline

NAMES = ("tx40", "kr300", "panda", "lwr4", "ur10e", "baxter")
FALL = re.compile(r"error [\d.–]+ %( \([^)]*\))? → [\d.–]+ %", re.IGNORECASE)


def of_gallery(file: str, folder: Path) -> Machine:
    """Return a robot of the gallery with its log."""
    hidden = next(h for h in HIDDEN if h.file == file)
    path = next(p for p in urdfs() if p.name == file)
    log = folder / f"{path.stem}.csv"
    log_of(with_hidden(by_pinocchio(path), hidden), 3).write(log)
    return Machine(path, (log,))


def compiles(path: Path) -> str:
    """Return `yes`, or MuJoCo's message; without meshes, whose packages it does not find."""
    tree = etree.parse(path)
    for shape in tree.xpath("//visual | //collision"):
        shape.getparent().remove(shape)
    try:
        mujoco.MjModel.from_xml_string(etree.tostring(tree).decode())
    except ValueError as error:
        return str(error).splitlines()[0]
    return "yes"


def row(name: str, machine: Machine, folder: Path) -> tuple[str, ...]:
    """Return name, first line, whether it states the fall, and what MuJoCo says."""
    mechanism = ident.load(machine.mechanism)
    for effect in machine.effects:
        mechanism = mechanism.with_effect(effect)
    history = ident.grow(mechanism, ident.complete(mechanism, list(machine.train)))
    line = headline(assess_growth(history))
    written = history.fit.write_urdf(folder / "identified.urdf")
    return name, line, "yes" if FALL.search(line) else "no", compiles(written)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("names", nargs="*", help="default: all")
    parser.add_argument("--data", action="append", type=Path, default=[], metavar="DIR")
    given = parser.parse_args()
    sources: dict[str, Callable[[Path], Machine] | None] = {
        h.file: lambda folder, file=h.file: of_gallery(file, folder) for h in HIDDEN
    }
    for name in NAMES:
        module = importlib.import_module(f"machines.{name}")
        source = located(module.SOURCE, [*given.data, SHARED])
        sources[name] = source and (lambda folder, m=module, s=source: m.convert(s, folder))
    print("| machine | first line | states the fall | MuJoCo compiles it |\n|---|---|---|---|")
    for name in given.names or sources:
        with tempfile.TemporaryDirectory() as folder:
            source = sources[name]
            cells = row(name, source(Path(folder)), Path(folder)) if source else (name, "no data")
            print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
