"""Broken URDFs: each is refused in one line that says what is wrong, where, and what is right."""

from __future__ import annotations

import pytest

BOMB = """<?xml version="1.0"?>
<!DOCTYPE lolz [<!ENTITY a "lol"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">
<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;"><!ENTITY d "&c;&c;&c;&c;&c;&c;&c;&c;&c;&c;">]>
<robot name="&d;"><link name="base"/></robot>"""
EXTERNAL = """<?xml version="1.0"?>
<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]>
<robot name="&x;"><link name="base"/></robot>"""
DOCTYPE = '<!DOCTYPE robot SYSTEM "http://example.org/urdf.dtd">\n<robot name="arm"/>'

WHOLE = {  # the file's whole content, and words of the message
    "empty": ("", ("XML",)),
    "blank": (" \n", ("XML",)),
    "not XML": ("once upon a time", ("XML", "line 1")),
    "binary": ("\x00\x01\x02", ("XML",)),
    "JSON": ('{"robot": {}}', ("XML",)),
    "entity bomb": (BOMB, ("document type", "remove")),
    "external entity": (EXTERNAL, ("document type", "remove")),
    "DOCTYPE": (DOCTYPE, ("document type", "remove")),
    "other root": ("<sdf><model/></sdf>", (":1", "<sdf>", "<robot>")),
    "no link": ('<robot name="r"/>', ("<link>", "a joint")),
    "no joint": ('<robot name="r"><link name="a"/></robot>', ("no joint that moves",)),
    "undeclared namespace": ('<robot name="r"><link name="a"/><x:y/></robot>', ("XML",)),
}

# part of the arm's URDF, what stands there instead, and words of the message
EDITS = {
    "truncated": ("</robot>\n", "", ("XML", "line")),
    "nameless link": ('<link name="tool"/>', "<link/>", (":17", "<link>", "name")),
    "nameless joint": ('<joint name="flange" ', "<joint ", ("<joint>", "name")),
    "two links of one name": ('<link name="tool"/>', '<link name="fore"/>', (":17", "line 11")),
    "two joints of one name": ('"flange"', '"elbow"', ("elbow", "line 25", "differ")),
    "unknown parent": ('<parent link="fore"/>', '<parent link="for"/>', ("for", "'fore'")),
    "unknown child": ('<child link="tool"/>', '<child link="tol"/>', ("flange", "'tool'")),
    "no parent": ('<parent link="fore"/>', "", ("flange", "<parent link")),
    "empty child": ('<child link="tool"/>', "<child/>", ("flange", "<child link")),
    "two parents": ('<child link="tool"/>', '<child link="upper"/>', ("'upper'", "[[closure]]")),
    "ring": ('<child link="tool"/>', '<child link="base"/>', ("ring", "ground", "closure")),
    "link nobody reaches": ("</robot>", '<link name="lost"/></robot>', ("'lost'", "fixed")),
    "unknown type": ('"revolute"', '"revolut"', ("'revolut'", "did you mean 'revolute'?")),
    "no type": (' type="revolute"', "", ("shoulder", "valid: ball, continuous")),
    "zero axis": ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', (":22", "axis", "direction")),
    "axis of two": ('<axis xyz="0 1 0"/>', '<axis xyz="0 1"/>', ("0 1", "3 finite numbers")),
    "NaN axis": ('<axis xyz="0 1 0"/>', '<axis xyz="0 nan 0"/>', (":22", "3 finite numbers")),
    "text in origin": ('xyz="0 0 0.3"', 'xyz="0 0 o.3"', (":21", "o.3", "3 finite numbers")),
    "inf in origin": ('xyz="0 0 0.3"', 'xyz="0 0 inf"', (":21", "3 finite numbers")),
    "decimal comma": ('xyz="0 0 0.3"', 'xyz="0 0 0,3"', ("0,3", "3 finite numbers")),
    "number of Python": ('xyz="0 0 0.3"', 'xyz="0 0 1_0"', ("1_0", "3 finite numbers")),
    "huge number": ('xyz="0 0 0.3"', 'xyz="0 0 1e300"', ("1e300", "3 finite numbers")),
    "text in rpy": ('rpy="0 0 0"', 'rpy="0 0 pi/2"', ("pi/2", "3 finite numbers")),
    "negative mass": ('mass value="1.5"', 'mass value="-1.5"', (":7", "upper", "-1.5 kg", "≥ 0")),
    "NaN mass": ('mass value="1.5"', 'mass value="nan"', (":7", "mass", "finite number")),
    "mass in words": ('mass value="1.5"', 'mass value="1.5 kg"', ("1.5 kg", "finite number")),
    "no mass": ('<mass value="1.5"/>', "", ("upper", "<mass>")),
    "no mass value": ('<mass value="1.5"/>', "<mass/>", ("mass", "finite number")),
    "no inertia": (
        '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/>',
        "",
        ("upper", "<inertia>"),
    ),
    "inertia without izz": (' izz="0.02"', "", ("izz", "finite number")),
    "infinite inertia": ('izz="0.02"', 'izz="inf"', ("izz", "finite number")),
    "lower above upper": ('lower="-2"', 'lower="3"', (":23", "shoulder", "above upper", "swap")),
    "limit in words": ('upper="2"', 'upper="open"', ("open", "finite number")),
    "effort in words": ('effort="50"', 'effort="much"', (":23", "much", "finite number")),
    "mimics nobody": (
        '<axis xyz="0 1 0"/>\n  </joint>',
        '<axis xyz="0 1 0"/><mimic joint="shoulde"/></joint>',
        ("elbow", "mimics", "'shoulder'"),
    ),
    "mimics itself": (
        '<axis xyz="0 1 0"/>\n  </joint>',
        '<axis xyz="0 1 0"/><mimic joint="elbow"/></joint>',
        ("elbow", "mimics", "shoulder"),
    ),
    "mimic multiplier": (
        '<axis xyz="0 1 0"/>\n  </joint>',
        '<axis xyz="0 1 0"/><mimic joint="shoulder" multiplier="two"/></joint>',
        ("multiplier", "two", "finite number"),
    ),
}


@pytest.mark.parametrize(("content", "words"), WHOLE.values(), ids=WHOLE)
def test_files_that_are_no_urdf(content, words, arm, refused):
    arm.write_text(content)
    outcome = refused(("arm.urdf", *words), "check", arm)
    assert "root:" not in outcome.err
    assert "lollol" not in outcome.err


@pytest.mark.parametrize(("old", "new", "words"), EDITS.values(), ids=EDITS)
def test_urdfs_with_one_fault(old, new, words, arm, change, refused):
    change(arm, old, new)
    refused(("arm.urdf", *words), "check", arm)


def test_all_joints_fixed(arm, change, refused):
    for kind in ("revolute", "continuous"):
        change(arm, f'"{kind}"', '"fixed"')
    refused(("arm.urdf", "no joint that moves", "fixed"), "check", arm)


def test_a_file_of_fifty_megabytes(arm, refused):
    with arm.open("ab") as stream:
        stream.truncate(60_000_000)
    refused(("arm.urdf", "60000000 bytes", "at most"), "check", arm)


def test_utf16(arm, refused):
    arm.write_bytes(BOMB.replace('"1.0"', '"1.0" encoding="utf-16"').encode("utf-16"))
    outcome = refused(("arm.urdf",), "check", arm)
    assert "lollol" not in outcome.err


def test_shapes_are_not_looked_at(arm, change, done):
    change(arm, '<link name="tool"/>', '<link name="tool"><visual><geometry/></visual></link>')
    done("check", arm)


def test_what_urdfdom_stumbles_over(arm, change, done):
    change(arm, 'effort="50"', 'effort="50 "')
    change(arm, 'value="1.5"', 'value=" 1.5"')
    change(arm, "</joint>", '<dynamics damping="?"/></joint>')
    done("check", arm)


def test_products_of_inertia_may_be_left_out(arm, change, done):
    change(arm, ' ixy="0" ixz="0"', "")
    done("check", arm)
