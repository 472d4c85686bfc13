"""Values of Python and numpy as those of a spec."""

import math
from collections.abc import Mapping
from os import PathLike, fspath


def plain(value: object, key: str = "") -> object:
    """`value` made of dictionaries, lists, texts, truth values and finite numbers only. `key` is its path in the spec.

    Raises ValueError or TypeError, with key and value, at the first that a spec cannot hold.
    """
    if isinstance(value, Mapping):
        return {_name(name, key): plain(of, f"{key}.{name}".lstrip(".")) for name, of in value.items() if of is not None}
    if isinstance(value, (list, tuple, range)):
        return [plain(of, f"{key}[{i}]") for i, of in enumerate(value)]
    if isinstance(value, PathLike):
        value = fspath(value)
    if isinstance(value, str):
        return _text(value, key)
    if isinstance(value, bool):
        return value
    if isinstance(value, int):
        if not -(2**63) <= value < 2**63:
            raise ValueError(f"{key} is a whole number of {value.bit_length()} bits: must be between -2^63 and 2^63 - 1")
        return int(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{key} = {value}: must be a finite number")
        return float(value)
    # arrays and scalars of numpy, tensors, columns of data frames
    if hasattr(value, "tolist") and not isinstance(unpacked := value.tolist(), type(value)):
        return plain(unpacked, key)
    raise TypeError(f"{key} = {value!r}: is of type {type(value).__name__}, which a spec cannot hold")


def _name(name: object, key: str) -> str:
    if not isinstance(name, str):
        raise TypeError(f"{key} has the key {name!r} of type {type(name).__name__}; keys must be texts")
    return _text(name, key)


def _text(text: str, key: str) -> str:
    try:
        text.encode()
    except UnicodeEncodeError:
        raise ValueError(f"{key} = {text!r}: must be a text in Unicode") from None
    return str(text)
