"""Files of weights that others saved: read without running anything, and unwrapped from what trainers put around them.

A training loop saves its weights beside its optimizer, under a name of its own; a wrapper for several devices, or one
that compiles, puts its own name before each tensor's. Neither says anything of the model.
"""

from __future__ import annotations

import os
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from salad.errors import WeightsError, reason
from salad.files import is_web_page, open_file
from salad.network.config import MOST_OF_WEIGHTS

WRAPPERS = ("state_dict", "model_state_dict", "model", "ema", "ema_state_dict", "model_ema", "params", "weights")
"""Names under which trainers save the weights; the first that a file has is taken."""
PREFIXES = ("module.", "_orig_mod.", "model.", "net.", "network.")
"""What wrappers put before the name of every tensor."""

_DEPTH = 4  # of dictionaries within one another
_ZIP = b"PK\x03\x04"  # how what torch saves begins
_CUT = (
    "unexpected EOF",
    "Ran out of input",
    "truncated",
    "incomplete metadata",
    "header too small",
    "invalid header length",
)
_SHOWN = 3  # names, where it is said what was found


def read_tensors(path: Path) -> Mapping[str, Tensor]:
    """The named tensors of a foreign file; whatever it holds, no code of it runs.

    Raises:
        WeightsError: If it cannot be read safely, or holds something else than tensors.
    """
    length = _checked_file(path)
    # A safetensors file holds numbers and names; everything else is a pickle, of which torch's reader runs no code.
    if path.suffix == ".safetensors":
        try:
            return _named(load_file(path))
        except (SafetensorError, OSError) as error:
            raise _unreadable(path, error, f"is no safetensors file that can be read: {reason(error)}") from error
    try:
        raw = load_pickle(path)
    except Exception as error:  # a foreign pickle may fail in any way; none may run code
        said = "is no file of weights that can be read safely: fetch it again, or save the model's state_dict alone"
        raise _unreadable(path, error, said) from error
    raw = _unwrapped(raw)
    if not isinstance(raw, Mapping) or not all(isinstance(value, Tensor) for value in raw.values()):
        names = ", ".join(sorted(str(key)[:60] for key in raw)[:_SHOWN]) if isinstance(raw, Mapping) else ""
        found = f" ({names} ...)" if names else ""
        raise WeightsError(f"{path} holds something else than named tensors{found}: save the model's state_dict alone")
    # A tensor may be one number seen a trillion times, or a view of another's numbers.
    if sum(value.numel() * value.element_size() for value in raw.values()) > 4 * length:
        raise WeightsError(f"{path} says it holds more numbers than fit into its {length:,} bytes: fetch it again")
    return _named(raw)


def load_pickle(path: Path) -> Any:
    """What torch saved, on the processor; nothing in it is run, and torch is quiet about what others wrote.

    Raises:
        Exception: Anything at all for a damaged or foreign file.
    """
    with warnings.catch_warnings():  # of pickles that torch would not have written
        warnings.simplefilter("ignore")
        return torch.load(path, map_location="cpu", weights_only=True)


def _unwrapped(raw: Any) -> Any:
    for _ in range(_DEPTH):
        wrapped = raw if isinstance(raw, Mapping) else {}
        inner = next((wrapped[name] for name in WRAPPERS if isinstance(wrapped.get(name), Mapping)), None)
        if inner is None:
            break
        raw = inner
    return raw


def _named(raw: Mapping[Any, Tensor]) -> Mapping[str, Tensor]:
    """The tensors without what wrappers put before all their names, one around the other."""
    tensors = {str(key): value for key, value in raw.items()}
    while tensors and (found := [prefix for prefix in PREFIXES if all(key.startswith(prefix) for key in tensors)]):
        tensors = {key.removeprefix(found[0]): value for key, value in tensors.items()}
    return tensors


def _checked_file(path: Path) -> int:
    """How many bytes a file of weights has; nothing in it is packed, as torch packs nothing.

    Raises:
        WeightsError: If it is no regular file, empty, cut short or a web page, longer than any model's, or would
            unpack to more than it is long.
    """
    try:
        with open_file(path) as file:
            length = os.fstat(file.fileno()).st_size
            head = file.read(1 << 10)
            whole = zipfile.is_zipfile(file)
            packed = whole and any(info.compress_type for info in zipfile.ZipFile(file).infolist())
    except (OSError, zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        cut = isinstance(error, OSError) and error.filename is None  # it opened, and its list points beyond its end
        said = "is cut short: fetch it again" if cut else f"cannot be read ({reason(error)}): fetch it again"
        raise WeightsError(f"{path} {said}") from error
    if is_web_page(head):
        raise WeightsError(f"{path} is a web page, not weights: open its address in a browser, and fetch the file")
    if not head or (head.startswith(_ZIP) and not whole):  # the list of what it holds stands at its end
        raise WeightsError(f"{path} is {'cut short' if head else 'empty'}: fetch it again")
    if packed or length > MOST_OF_WEIGHTS:
        raise WeightsError(f"{path} is no file of weights that can be read safely (packed, or too long for a model)")
    return length


def _unreadable(path: Path, error: Exception, otherwise: str) -> WeightsError:
    """The sentence for a file that its reader gave up; a cut one is called that, as far as the reader tells."""
    cut = isinstance(error, EOFError) or any(word in str(error) for word in _CUT)
    return WeightsError(f"{path} {'is cut short: fetch it again' if cut else otherwise}")
