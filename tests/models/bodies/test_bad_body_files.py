"""A body file that cannot be meant ends in one line that names the place and what was expected."""

import pytest
from bench_arm import ARM

from invdyn.models.bodies.body import Body
from invdyn.models.bodies.scalars import BodyError

LINK = '[[links]]\nname="{0}"\njoint="{1}"\ntip="{2}"\nlength=1\nmass=1\n'
BAD_FILES = {
    "broken TOML": (ARM.replace("mass = 1.5", "mass = = 1.5"), r"broken TOML.*line 10"),
    "a key twice": (ARM.replace("mass = 1.5", "mass = 1.5\nmass = 1.6"), r"broken TOML.*line 11"),
    "no text": (b"\xff\xfe\x00\x01", "not UTF-8"),
    "empty": ("", r"not a body.*\[\[links\]\]"),
    "another TOML": ('[project]\nname = "x"\n', r"not a body.*\[\[links\]\].*none"),
    "link for links": (ARM.replace("[[links]]", "[[link]]"), r"is \[\[link\]\] meant as \[\[links\]\]"),
    "a single table": ("[links]\nname = 'a'\n", "two brackets"),
    "no link": ("links = []\n", "at least one link"),
    "unknown key": (ARM.replace("base", "bse"), r"unknown key 'bse' \(did you mean 'base'\?\)"),
    "unknown key of a link": (ARM.replace("inertia", "inertai"), r"link 2: unknown key 'inertai'.*'inertia'"),
    "key with nothing near": (ARM.replace("com =", "zz ="), "unknown key 'zz'; known keys are name, joint"),
    "missing length": (ARM.replace("length = 0.30\n", ""), "link 1: .*missing: length"),
    "missing names": (ARM.replace('joint = "elbow"\ntip = "wrist"\n', ""), "link 2: .*missing: joint, tip"),
    "negative mass": (ARM.replace("mass = 1.5", "mass = -1.5"), r"'upper_arm': mass in kg.*got -1\.5"),
    "zero length": (ARM.replace("0.30", "0"), r"'upper_arm': length in m: expected a positive number, got 0"),
    "nan": (ARM.replace("0.30", "nan"), "length in m: expected a finite number, got nan"),
    "infinite": (ARM.replace("mass = 1.5", "mass = inf"), "expected a finite number, got inf"),
    "beyond a float": (
        ARM.replace("mass = 1.5", "mass = 1" + "0" * 400),
        "got a larger one; is the unit right",
    ),
    "beyond what is read": (ARM.replace("mass = 1.5", "mass = 1" + "0" * 5000), "an integer too long to be read"),
    "near a float's limit": (ARM.replace("mass = 1.5", "mass = 1e308"), r"expected a number up to 1e\+07, got 1e\+308"),
    "hardly anything": (ARM.replace("mass = 1.5", "mass = 1e-308"), "expected 1e-09 or more, got 1e-308"),
    "a sd of nothing": (ARM.replace("mass = 1.5", "mass = {mean = 1.5, sd = 1e-30}"), "mass: expected a sd from 1e-07"),
    "nested deep": ("x = " + "[" * 100_000, "nested too deep"),
    "a name that cannot be printed": (ARM.replace('"wrist"', '"a\\u0000b"'), "characters that can be printed"),
    "a name without end": (ARM.replace('"wrist"', f'"{"x" * 200}"'), "up to 100 characters"),
    "text": (ARM.replace("0.30", '"30 cm"'), "expected a finite number, got '30 cm'"),
    "truth": (ARM.replace("mass = 1.5", "mass = true"), "expected a finite number, got True"),
    "negative inertia": (ARM.replace("0.004", "-0.004"), "'forearm': inertia.*got -0.004"),
    "com in mm": (ARM.replace("com = 0.1", "com = 100.0"), "com within 3 lengths.*0.75 m.*100 m"),
    "length in mm": (ARM.replace("0.30", "300"), r"'upper_arm': length in m: expected up to 30,.*got 300; is the unit"),
    "mass in mg": (ARM.replace("mass = 1.5", "mass = 1.5e6"), r"mass in kg: expected up to 100000, .*got 1.5e\+06"),
    "prior of a length in mm": (ARM.replace("0.30", "{mean = 300, sd = 1}"), "length in m: expected up to 30,"),
    "inertia in kg·cm²": (ARM.replace("0.004", "200"), "inertia as of mass within 20 lengths, .*got 200"),
    "no resistance": (
        ARM.replace("com = 0.1\ninertia = 0.004", "com = 0\ninertia = 0"),
        "com and inertia are both 0",
    ),
    "gravity as a number": (ARM.replace("[0.0, -9.81]", "-9.81"), r"gravity in m/s²: expected 2 numbers"),
    "gravity in 3-D": (
        ARM.replace("[0.0, -9.81]", "[0.0, 0.0, -9.81]"),
        r"expected 2 numbers, got \[0.0, 0.0",
    ),
    "gravity of text": (ARM.replace("[0.0, -9.81]", '["down", 1]'), "finite number, got 'down'"),
    "base": (ARM.replace("[0.1, 0.2]", "[0.1, inf]"), "base in m: expected a finite number"),
    "name of a body": (ARM.replace('"bench arm"', "3"), "name of a body: expected a text"),
    "blank name": (ARM.replace('"upper_arm"', '" "'), "name of a link: expected a text that is not blank"),
    "link name twice": (
        LINK.format("a", "b", "c") + LINK.format("a", "c", "d"),
        "names of their own.*links.*'a' twice",
    ),
    "tip twice": (
        LINK.format("a", "b", "c") + LINK.format("e", "f", "c"),
        "names of their own.*sites.*'c' twice",
    ),
    "joint twice": (
        LINK.format("a", "b", "c") + LINK.format("e", "b", "d"),
        "names of their own.*joints.*'b' twice",
    ),
    "tip called as the base": (LINK.format("a", "b", "b"), "'b' is the tip of one link but the joint"),
    "unknown uncertainty": (ARM + "masss = 0.1\n", "uncertainty: unknown key 'masss'.*'mass'"),
    "negative uncertainty": (ARM.replace("0.05", "-0.05"), "relative standard deviations of 0, or from"),
    "uncertainty no table": ("uncertainty = 0.1\n" + ARM[: ARM.index("[unc")], "uncertainty.*as a table"),
    "prior without sd": (
        ARM.replace("mass = 1.5", "mass = {mean = 1.5}"),
        "link 1: mass: expected a number, {mean",
    ),
    "prior of sd 0": (
        ARM.replace("mass = 1.5", "mass = {mean = 1.5, sd = 0}"),
        "expected a positive sd, got 0",
    ),
    "prior of negative mean": (
        ARM.replace("mass = 1.5", "mass = {mean = -1, sd = 1}"),
        "allows negative values",
    ),
    "prior of text": (
        ARM.replace("mass = 1.5", 'mass = {mean = "a", sd = 1}'),
        "mass's mean: expected a finite",
    ),
    "learned from 0": (
        ARM.replace("mass = 1.5", "mass = {start = 0}"),
        "mass in kg: expected a positive number",
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_file_is_named_with_what_was_expected(write, case):
    text, message = BAD_FILES[case]
    path = write(text)
    with pytest.raises(BodyError, match=message) as caught:
        Body.from_toml(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
