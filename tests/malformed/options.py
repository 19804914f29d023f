"""Every option that takes a number at and beyond its limits, and texts where names are expected."""

from collections.abc import Iterator

from .case import (
    BLIND,
    COMPARE,
    DEMO,
    DIAGNOSE,
    HUGE,
    INFER,
    NUMBERS,
    PLOT,
    SIMULATE,
    TRACKED,
    Case,
    with_option,
)

REALS = (*NUMBERS, "inf", "-inf", "1e9", "1e-9", "١٢", "one", "")
COUNTS = ("-1", "0", str(2**31), str(2**63), str(2**64), str(-(2**63)), str(10**30), HUGE, "1e3", "1.5", "", "0x10")
TEXTS = ("", "\0", "\n", "$\\frac", "x" * 10_000, ",", ",,", "..", "\ud800", "🦾", "--help ", "smc;rm")
RANGES = ("", ":", "::", "a:b", "5:2", "-3:", f"{HUGE}:", f":{10**30}", "1e3:", "0:2:1", "١:٩", "\0:", "0.5:3", "0:1")


def cases() -> Iterator[Case]:
    """Real numbers, counts and seeds, texts."""
    given = [(SIMULATE, option) for option in ("--duration", "--fps", "--noise")]
    given += [((*TRACKED, "--scale", "body"), "--fps"), (TRACKED, "--scale"), (COMPARE, "--held-out")]
    for call, option in given:
        for value in REALS:
            yield Case("number in an option", with_option(call, option, value), what=f"{option} {value}")
    sizes = ("--filters", "--particles", "--set draws", "--seed", "--workers")
    counted = [(INFER, option) for option in sizes]
    counted += [(DIAGNOSE, option) for option in ("--max-effects", "--seed", "--workers")]
    counted += [(SIMULATE, "--seed"), (COMPARE, "--particles"), (COMPARE, "--seed")]
    for call, option in counted:
        for value in COUNTS:
            yield Case("count in an option", with_option(call, option, value), what=f"{option} {value}")
    for method in ("smc", "bootstrap", "particle-gibbs", "vsmc", "nuts", "svi"):
        for option in ("--particles", "--filters", "--set draws"):
            if option == "--particles" and method in ("nuts", "svi"):  # they have none
                continue
            call = with_option((*INFER, "--method", method), option, str(10**9))
            yield Case("memory", call, what=f"{method} {option} 10⁹")
    for method in ("bootstrap", "particle-gibbs", "vsmc", "nuts", "svi", "differentiate"):
        for more in (("--seed", str(2**63 - 1)), ("--filters", "1"), ("--particles", "1")):
            call = with_option((*INFER, "--method", method), *more)
            yield Case("least and most", call, what=f"{method} {' '.join(more)}")
    for value in COUNTS:
        if value not in ("0", str(2**31), "0x10"):  # those would be fine, and take long
            yield Case("count in an option", with_option(DEMO, "--seed", value), what=f"--seed {value}")
            yield Case("count in an option", with_option(BLIND, "--seed", value), what=f"--seed {value}")
        yield Case("count in an option", with_option(BLIND, "--cases", value), what=f"--cases {value}")
        yield Case("count in an option", with_option(BLIND, "--workers", value), what=f"--workers {value}")
        yield Case("count in an option", (*BLIND, "--kinds", f"none={value}"), what=f"--kinds none={value}")
    for value in TEXTS:
        for option in ("--method", "--torque", "--set noise", "--units", "--set base", "--workers"):
            yield Case("text in an option", with_option(INFER, option, value), what=f"{option} {value}")
        yield Case("text in an option", with_option(COMPARE, "--methods", value), what=f"--methods {value}")
        yield Case("text in an option", with_option(DIAGNOSE, "--exclude", value), what=f"--exclude {value}")
        for option in ("--kinds", "--method-command"):
            if value.strip():
                yield Case("text in an option", with_option(BLIND, option, value), what=f"{option} {value}")
        yield Case("text in an option", (*PLOT, value), what=f"one more word {value}")
    for value in RANGES:
        for call in (INFER, DIAGNOSE):
            yield Case("range in an option", with_option(call, "--frames", value), what=f"--frames {value}")
