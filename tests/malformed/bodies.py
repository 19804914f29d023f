"""Body files: numbers and names of every kind, deep nesting, and other forms."""

from collections.abc import Iterator

from .case import BODY, COLUMNS, COMPARE, DIAGNOSE, HUGE, INFER, NUMBERS, SIMULATE, Case, table, with_option

NAMES = ("", " ", "a\0b", "a\nb", "a\tb", "\x1b[31mred", "x" * 10_000, "$\\frac", "$", "_^{}$", "\u202eb", "..", "a/b")
NAMES += ("%s", "{0}", "<script>", "time", "\ufeffa", "é", "٣")
VALUES = (*NUMBERS, "-1.0", "inf", "1e3", '"1"', "true", "[1]", "{}")
FORMS = {
    "deep arrays": "x = " + "[" * 100_000,
    "deep tables": "x = " + "{a = " * 50_000,
    "deep keys": ".".join("a" * 3_000) + " = 1\n",
    "closed arrays": "x = " + "[" * 5_000 + "]" * 5_000,
    "an integer": f"x = {HUGE}",
    "a date": BODY.replace("mass = 0.5", "mass = 1979-05-27"),
    "links a number": "links = 3",
    "links of numbers": "links = [1, 2]",
    "links empty": "links = []",
    "link in link": BODY.replace("[uncertainty]", "\n[[links]]\n[[links.links]]\n"),
    "uncertainty a number": "uncertainty = 3\n" + BODY.replace("[uncertainty]", ""),
    "a key twice": BODY.replace("mass = 0.5", "mass = 0.5\nmass = 0.5"),
    "a name of a number": BODY.replace('"wrist"', "3"),
    "a name of a list": BODY.replace('"wrist"', '["wrist"]'),
    "empty": "",
    "a byte": b"\xff",
    "UTF-16": BODY.encode("utf-16"),
    "BOM": "\ufeff" + BODY,
    "zeros": bytes(1000),
    "a thousand links": BODY.replace("[uncertainty]", "")
    + "".join(f'[[links]]\nname="l{i}"\njoint="j{i}"\ntip="t{i}"\nlength=1.0\nmass=1.0\n' for i in range(1000)),
}
ROBOTS = {
    "deep": "<a>" * 100_000,
    "deep and closed": '<robot name="a">' + "<a>" * 20_000 + "</a>" * 20_000 + "</robot>",
    "entities": '<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa">'
    + f'<!ENTITY b "{"&a;" * 1000}"><!ENTITY c "{"&b;" * 1000}">]><robot>&c;</robot>',
    "empty": "",
    "a byte": b"\xff",
    "no robot": "<html/>",
    "no joints": "<mujoco/>",
    "robot alone": '<robot name="a"/>',
    "a number in words": '<robot name="a"><link name="b"><inertial><mass value="x"/></inertial></link></robot>',
}


def cases() -> Iterator[Case]:
    """Numbers, names, forms of TOML, then of robot files."""
    for value in VALUES:
        for what, content in numbered(value):
            yield Case("number in a body", SIMULATE, {"arm.toml": content}, what=what)
            yield Case("number in a body", INFER, {"arm.toml": content}, what=what)
    for value in NAMES:
        for role in ("arm", "forearm", "elbow", "wrist"):
            yield from named(role, value)
    for call in (SIMULATE, INFER, DIAGNOSE):
        for what, content in FORMS.items():
            yield Case("form of a body", call, {"arm.toml": content}, what=what)
    for suffix in ("urdf", "xml", "mjcf"):
        for what, content in ROBOTS.items():
            call = with_option(SIMULATE, "--body", f"arm.{suffix}")
            yield Case("form of a robot file", call, {f"arm.{suffix}": content}, what=f"{suffix} {what}")


def numbered(value: str) -> Iterator[tuple[str, str]]:
    """Body files with that value in each place where a number stands."""
    for place in ("length = 1.0", "mass = 0.5", "com = 0.5", "inertia = 0.04"):
        text = f"{place.split()[0]} = {value}"
        yield text, BODY.replace(place, text)
    yield f"gravity {value}", BODY.replace("-9.81", value)
    yield f"base {value}", BODY.replace("base = [0.0", f"base = [{value}")
    yield f"uncertainty {value}", BODY + f"mass = {value}\n"
    for prior in (f"{{mean = {value}, sd = 0.1}}", f"{{mean = 1.0, sd = {value}}}", f"{{start = {value}}}"):
        yield f"mass = {prior}", BODY.replace("mass = 0.5", f"mass = {prior}")


def named(role: str, name: str) -> Iterator[Case]:
    """Body and recording with that name in place of another; drawn, where a figure could choke on it."""
    quoted = "".join(c if c.isprintable() and c not in '"\\' else f"\\u{ord(c):04x}" for c in name)
    columns = [column.replace(f"{role}_", f"{name}_") for column in COLUMNS]
    header = ",".join('"' + column.replace('"', '""') + '"' for column in columns)
    content = {
        "arm.toml": BODY.replace(f'"{role}"', f'"{quoted}"'),
        "rec.csv": header + table()[len(",".join(COLUMNS)) :],
    }
    what = f"{role} called {name[:20]!r}"
    yield Case("name in a body", SIMULATE, content, what=what)
    if "$" in name or name == "é":
        outputs = ("--out", "f.svg", "--out", "f.sto", "--out", "f.csv")
        outputs += ("--out", "f.gif") if name == "$\\frac" else ()
        yield Case("name in a body", (*INFER, *outputs), content, what=what)
        yield Case("name in a body", COMPARE, content, what=what)
        yield Case("name in a body", DIAGNOSE, content, what=what)
    else:
        yield Case("name in a body", INFER, content, what=what)
