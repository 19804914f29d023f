"""Dataclasses of arrays and tensors, in one another, as tensors by dotted name: the form that checkpoints hold."""

from dataclasses import fields, is_dataclass
from typing import Any, get_args, get_type_hints

import numpy as np
import torch

from invdyn.inference.execution.distribute import Tensors


def flattened(record: Any, prefix: str = "") -> Tensors:
    """The arrays and tensors of a dataclass, and of those in it, by dotted name."""
    tensors: Tensors = {}
    for field in fields(record):
        value = getattr(record, field.name)
        if is_dataclass(value):
            tensors |= flattened(value, f"{prefix}{field.name}.")
        elif value is not None:
            tensors[prefix + field.name] = torch.as_tensor(np.asarray(value))
    return tensors


def unflattened(kind: Any, tensors: Tensors, prefix: str = "") -> Any:
    """The dataclass of which :func:`flattened` is ``tensors``."""
    values: dict[str, Any] = {}
    for name, hint in get_type_hints(kind).items():
        if is_dataclass(hint):
            values[name] = unflattened(hint, tensors, f"{prefix}{name}.")
        elif prefix + name not in tensors:
            values[name] = None
        else:
            value = tensors[prefix + name]
            values[name] = value if torch.Tensor in (hint, *get_args(hint)) else value.numpy()[()]
    return kind(**values)
