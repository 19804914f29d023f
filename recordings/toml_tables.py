"""A TOML file that a user gives, as its tables."""

import tomllib
from pathlib import Path
from typing import Any

from .budget import read_document
from .errors import InputError, first_line


def read_toml(path: str | Path, what: str) -> dict[str, Any]:
    """Tables of a file that should be ``what``, such as "a calibration".

    Raises InputError for what is no TOML or too long for one, OSError for a file that cannot be opened.
    """
    content = read_document(path)
    try:
        return tomllib.loads(content.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: expected {what} in TOML ({first_line(error)})") from None
    except RecursionError:
        raise InputError(f"{path}: expected {what}, got TOML nested too deep for one") from None
    except ValueError:  # Python turns no more than 4,300 digits into an integer
        raise InputError(f"{path}: expected {what}, got TOML with an integer too long to be read") from None
