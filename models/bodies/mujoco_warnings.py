"""MuJoCo's warnings, kept: by itself it prints them and writes a log in the folder where one happens to be."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def kept_warnings(mujoco: Any) -> Iterator[list[str]]:
    """A list that fills with what MuJoCo warns of, in the module ``mujoco``; what was there before takes over again."""
    before, said = mujoco.get_mju_user_warning(), list[str]()
    mujoco.set_mju_user_warning(said.append)
    try:
        yield said
    finally:
        mujoco.set_mju_user_warning(before)
