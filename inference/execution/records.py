"""Results as a checkpoint holds them: values as JSON has them without loss, and the arrays in them as tensors.

A value is a number, a text, None, an array or a tensor, or a list, tuple, dataclass or mapping by text of such. A named
tuple comes back as a plain one. Arrays and tensors are named by their content: what is there twice is kept once. To
read a value runs no code, and makes no other objects than those of the dataclasses that the reader names.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint, digest


def keep(checkpoint: Checkpoint, value: Any) -> None:
    """Replace a checkpoint by one of a ``value``. Raises TypeError for one of another kind than those above."""
    plain = Plain()
    state = plain.of(value)
    checkpoint.save(plain.tensors, value=state)


def kept(checkpoint: Checkpoint, *kinds: type) -> Any:
    """What :func:`keep` was given, with dataclasses of these ``kinds``; None where there is no checkpoint yet."""
    found = checkpoint.load()
    return None if found is None else Restored(found[0], kinds).of(found[1]["value"])


def content_digest(value: Any, plain: "Plain | None" = None) -> str:
    """A short hexadecimal name of a value's content: equal for equal numbers, whichever type holds them."""
    known = json.dumps((plain or Plain()).of(value), sort_keys=True)
    return hashlib.sha256(known.encode()).hexdigest()[:24]


class Plain:
    """Values as JSON holds them; a subclass may know further kinds.

    Attributes:
        tensors: those in them, by name.
    """

    def __init__(self) -> None:
        self.tensors: dict[str, Tensor] = {}

    def of(self, value: Any) -> Any:
        """A value as JSON holds it."""
        if isinstance(value, Tensor | np.ndarray):
            if isinstance(value, Tensor):
                kind, tensor = "tensor", value.detach().cpu()
            else:  # contiguous, an array of one number would have an axis
                kind, tensor = "array", torch.as_tensor(np.ascontiguousarray(value).reshape(value.shape))
            name = digest(tensor)
            self.tensors[name] = tensor
            return {kind: name}
        if isinstance(value, list | tuple):
            return {"list" if isinstance(value, list) else "tuple": [self.of(each) for each in value]}
        if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
            return {"dict": {key: self.of(each) for key, each in value.items()}}
        if is_dataclass(value) and not isinstance(value, type):
            inner = {each.name: self.of(getattr(value, each.name)) for each in fields(value)}
            return {"record": type(value).__name__, "fields": inner}
        value = value.item() if isinstance(value, np.generic) else value
        if value is None or isinstance(value, bool | int | float | str):
            return value
        raise TypeError(f"expected numbers, texts, arrays and records of them, got {type(value).__name__}")


class Restored:
    """Values of which :class:`Plain` made what JSON holds, with its ``tensors`` and dataclasses of some ``kinds``."""

    def __init__(self, tensors: Mapping[str, Tensor], kinds: tuple[type, ...]):
        self.tensors, self.kinds = tensors, {each.__name__: each for each in kinds}

    def of(self, state: Any) -> Any:
        """The value."""
        match state:
            case {"tensor": name}:
                return self.tensors[name]
            case {"array": name}:
                return self.tensors[name].numpy()
            case {"list": values}:
                return [self.of(each) for each in values]
            case {"tuple": values}:
                return tuple(self.of(each) for each in values)
            case {"dict": values}:
                return {key: self.of(each) for key, each in values.items()}
            case {"record": kind, "fields": own}:
                return self.kinds[kind](**{key: self.of(each) for key, each in own.items()})
        return state
