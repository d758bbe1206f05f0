"""`ident explore` started as a process and driven in a real browser."""

from __future__ import annotations

import json
import shutil
import socket

from websockets.sync.client import connect

from helpers import ROBOTS
from ident import load, read_fit
from pages import assert_legible

ARM = ROBOTS / "arm"
HOSTILE = "<img src=x onerror=document.title='taken'>"


def settled(page) -> None:
    """Nothing is worked out any more."""
    page.locator(".status.done").wait_for()
    page.locator("#effects:not(.stale)").wait_for()


def add(page, label: str) -> None:
    page.evaluate("document.querySelectorAll('#effects details').forEach((x) => x.open = true)")
    page.get_by_role("button", name=f"add {label}", exact=True).click()
    page.get_by_role("button", name=f"remove {label}", exact=True).wait_for()
    settled(page)


def rungs(page) -> list[list[str]]:
    lines = page.locator(".ladder tbody tr").all()
    return [[cell.inner_text() for cell in line.locator("th, td").all()] for line in lines]


def percent(words: str) -> float:
    return float(words.removesuffix("%"))


def test_the_error_falls_by_hand(serve, visit, tmp_path):
    served = serve(ARM, ARM / "run.csv")
    seen = visit(served.address)
    page = seen.page
    settled(page)
    assert page.get_by_role("button", name="Undo").is_disabled()
    assert page.locator("canvas").count() > 2

    groups = page.locator("#effects details:has(> ul > li):not(.several details)")
    opened = [each.get_attribute("open") is not None for each in groups.all()]
    assert opened == [True] + [False] * (len(opened) - 1)  # candidates, before all that is folded
    first = page.locator("#effects button").first
    assert (first.get_attribute("aria-label") or "").startswith("add coulomb:")  # one, not all
    shown = page.locator("#shown .chart").count()
    asked = page.get_by_role("button", name="preview coulomb:").first
    asked.hover()  # under the pointer it is beside the list, and goes with the pointer
    floating = page.locator("body > .place [aria-label*=': as it is and with']")
    floating.wait_for()
    page.mouse.move(1, 1)
    floating.wait_for(state="detached")
    asked.click()
    preview = page.locator("#effects [aria-label*=': as it is and with']")  # in its row
    preview.wait_for()
    assert len(rungs(page)) == 1  # nothing is added
    page.get_by_role("button", name="Verdict").click()  # nor does one replace the other
    page.locator("#shown").get_by_text("no proof of a cause").wait_for()
    assert preview.count() == 1
    page.get_by_role("button", name="Joint", exact=True).click()
    page.wait_for_function(
        "n => document.querySelectorAll('#shown .chart').length === n", arg=shown
    )
    asked.click()
    preview.wait_for(state="detached")

    add(page, "viscous:elbow")
    ladder = rungs(page)
    assert [line[0] for line in ladder] == ["nothing added", "+ viscous friction in elbow"]
    assert (
        page.locator("#status p")
        .inner_text()
        .startswith("+ viscous friction in elbow: elbow 25.5 % → ")
    )
    assert percent(ladder[1][3]) < 0.5 * percent(ladder[0][3])
    add(page, "coulomb:elbow")
    assert percent(rungs(page)[2][3]) < 1

    page.get_by_role("button", name="remove coulomb:elbow", exact=True).click()
    page.get_by_text("− dry friction in elbow (coulomb)", exact=True).wait_for()
    settled(page)
    page.get_by_role("button", name="back to rung 1: + viscous friction in elbow").click()
    page.wait_for_function("() => document.title")
    page.get_by_text("− dry friction in elbow (coulomb)", exact=True).wait_for(state="detached")
    settled(page)
    assert len(rungs(page)) == 2
    page.get_by_role("button", name="Undo").click()
    page.get_by_text("− dry friction in elbow (coulomb)", exact=True).wait_for()

    page.reload()  # goes on where it was
    page.get_by_text("− dry friction in elbow (coulomb)", exact=True).wait_for()
    settled(page)

    page.get_by_label("Save into").fill("mine")
    page.get_by_role("button", name="Save").click()
    page.get_by_text("saved into").wait_for()
    saved = tmp_path / "arm_explored" / "mine"
    mechanism = load(saved)
    assert [effect.label for effect in mechanism.effects] == ["viscous:elbow"]
    assert read_fit(saved / "fit.json", mechanism)
    page.get_by_label("Save into").fill("../../elsewhere")
    page.get_by_role("button", name="Save").click()
    page.get_by_text("is outside of").wait_for()
    assert page.locator(".status.bad").count() == 1

    assert seen.faults == []
    assert seen.hosts == {"127.0.0.1"}
    status, said = served.interrupt()
    assert status == 0
    assert "Traceback" not in said


def test_places_in_which_one_would_do_for_another_are_not_added_together(serve, visit):
    folder = ROBOTS / "four_bar"  # the friction of all its joints acts in one equation
    page = visit(serve(folder, folder / "run.csv").address).page
    settled(page)
    lines = page.locator("#effects .several > details > summary")
    assert lines.count() > 1
    assert all("in one of " in line for line in lines.all_inner_texts())
    assert page.get_by_role("button", name="add dry friction in").count() == 0
    tall = "() => document.documentElement.scrollHeight"
    before = page.evaluate(tall)
    page.locator("#effects li.sure li").first.hover()
    page.wait_for_timeout(500)
    assert page.evaluate(tall) == before


def test_keys_are_enough(serve, visit):
    page = visit(serve(ARM, ARM / "run.csv").address).page
    settled(page)
    page.get_by_label("Show only effects").focus()
    page.keyboard.type("viscous:elbow")
    page.keyboard.press("Tab")  # the group, which folds
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    page.get_by_role("button", name="remove viscous:elbow", exact=True).wait_for()
    settled(page)
    held = page.evaluate("() => document.activeElement.getAttribute('aria-label')")
    assert held == "remove viscous:elbow"
    reached = set()
    for _ in range(40):
        page.keyboard.press("Tab")
        reached.add(
            page.evaluate(
                "() => { const e = document.activeElement; "
                "return e.getAttribute('aria-label') || e.innerText || e.tagName; }"
            )
        )
    assert {"Joint", "Ladder", "Verdict"} & reached
    assert "back to rung 0: nothing added" in reached


def test_names_of_joints_and_files_are_text(serve, visit, tmp_path):
    escaped = HOSTILE.replace("<", "&lt;").replace(">", "&gt;")
    text = (ARM / "arm.urdf").read_text().replace('"elbow"', f'"{escaped}"')
    (tmp_path / "arm.urdf").write_text(text)
    toml = (ARM / "mechanism.toml").read_text().replace("elbow =", f'"{HOSTILE}" =')
    (tmp_path / "mechanism.toml").write_text(toml)
    log = (ARM / "run.csv").read_text().replace(".elbow", f".{HOSTILE}")
    (tmp_path / f"{HOSTILE}.csv").write_text(log)
    seen = visit(serve(tmp_path, tmp_path / f"{HOSTILE}.csv").address)
    settled(seen.page)
    assert HOSTILE in seen.page.locator("h1").inner_text()
    add(seen.page, f"viscous:{HOSTILE}")
    for view in ("Numbers", "Ladder", "Joint"):
        seen.page.get_by_text(view, exact=True).last.click()
        seen.page.wait_for_timeout(1500)
    assert seen.page.locator("img").count() == 0
    assert seen.page.title() != "taken"
    assert seen.faults == []


def test_it_prints_its_address_before_it_computes(serve):
    address = serve(ARM, ARM / "run.csv").address
    origin = address[: address.index("/", len("http://"))]
    with connect(address.replace("http", "ws", 1), origin=origin) as page:
        first = json.loads(page.recv(timeout=20))
        assert (first["busy"], first["effects"]) == (True, [])
        changed = {}
        while not changed.get("effects"):
            changed = json.loads(page.recv(timeout=60))


def test_a_port_that_is_taken_is_one_line(spoken):
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        held.listen()
        port = held.getsockname()[1]
        status, out, err = spoken("explore", ARM, ARM / "run.csv", "--port", port)
    assert (status, out) == (1, "")
    assert len(err.splitlines()) == 1
    assert f"error: port {port}: " in err
    assert "free one" in err


def test_long_names_on_a_phone(serve, visit, tmp_path):
    """Nothing is cut or lies on other words, before effects are added and after."""
    folder = tmp_path / "a_universal_robot_on_the_second_bench_of_the_laboratory"
    shutil.copytree(ARM, folder)
    for path in (folder / "mechanism.toml", folder / "arm.urdf", folder / "run.csv"):
        path.write_text(path.read_text().replace("shoulder", "shoulder_lift_joint_of_the_robot"))
    seen = visit(serve(folder, folder / "run.csv").address)
    page = seen.page
    settled(page)
    for width in (1400, 400):
        page.set_viewport_size({"width": width, "height": 800})
        page.reload()
        settled(page)
        assert assert_legible(page, width) > 20
    list_ = page.locator("#effects")  # no box that scrolls by itself
    assert list_.evaluate("list => list.scrollHeight - list.clientHeight") <= 1
    page.get_by_role("button", name="add dry friction in 4 places", exact=True).click()
    page.wait_for_function("() => document.querySelectorAll('.ladder tbody tr').length > 1")
    settled(page)
    page.evaluate("scrollTo(0, 500)")
    done = page.get_by_text("+ dry friction in", exact=False).first
    assert 0 <= done.bounding_box()["y"] < 200  # in view, wherever one scrolls
    for view in page.locator("#views button").all():
        view.click()
        page.locator("#views [aria-pressed=true]").get_by_text(view.inner_text()).wait_for()
        assert_legible(page, 400)
    assert seen.faults == []
