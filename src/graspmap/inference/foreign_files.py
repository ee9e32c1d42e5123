"""Other people's weights files as plain containers of tensors, read without running any code.

A state dict is a dictionary of tensors, but the format it is kept in (pickle) can carry any
program; a TorchScript file carries one in any case. State dicts go through PyTorch's restricted
reader, which builds tensors and nothing else. Of a TorchScript file only the list of tensors is
read, by a reader that knows nothing but lists, dictionaries and tensors; its program is not
looked at.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import re
import warnings
import zipfile
from collections import OrderedDict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from graspmap.errors import WeightsError
from graspmap.inference.weights import is_safetensors, read_safetensors

NO_STATE_DICT = "give a file written by torch.save(model.state_dict(), FILE)"
_AGAIN = "copy or download it again"
_CONVERT = (
    "if you trust it, open it with its authors' own code, write "
    "torch.save(model.state_dict(), 'weights.pt') and import that file"
)
_CONVERT_SCRIPT = (
    "if you trust it, write torch.save(torch.jit.load(FILE).state_dict(), 'weights.pt') "
    "and import that file"
)


def read_foreign(path: Path, content: bytes) -> Any:
    """What a weights file holds, built of tensors and plain containers only.

    Args:
        path: The file, for errors.
        content: Its bytes.

    Returns:
        For safetensors and TorchScript a dictionary of tensors by name; for other PyTorch files
        whatever was saved.

    Raises:
        WeightsError: The file would run code (it is not opened further), is damaged, is
            graspmap's own, or is of another format.
    """
    if is_safetensors(content):
        tensors, metadata = read_safetensors(path, content)
        if "graspmap" in metadata:
            raise WeightsError(path, "is a weights file of graspmap already", "use it as it is")
        return tensors
    if content[:1] != b"\x80" and content[:2] != b"PK":
        raise WeightsError(path, "is neither a PyTorch nor a safetensors file", NO_STATE_DICT)
    try:
        if content[:2] == b"PK" and _is_script(path, content):
            return _Script(content).tensors()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the errors below say it in one line
            return torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except WeightsError:
        raise
    except pickle.UnpicklingError as error:
        named = re.search(r"(?:GLOBAL|class|function|type) ([\w.]+\.[\w.]+)", str(error))
        what = named[1] if named else "instructions that no state dict has"
        raise WeightsError(
            path,
            f"is refused, because opening it could run code: it holds {what}, and not only tensors",
            _CONVERT,
        ) from error
    except Exception as error:  # a damaged file can make the readers raise anything
        raise WeightsError(
            path, f"is cut short, damaged, or no PyTorch file ({_first_line(error)})", _AGAIN
        ) from error


def _is_script(path: Path, content: bytes) -> bool:
    """Whether a zip file is a TorchScript program; errors for zip files that are not PyTorch's."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
        raise WeightsError(path, f"is cut short or damaged ({error})", _AGAIN) from error
    if any(name.endswith("/model.json") for name in names):
        problem = "is a TorchScript program in a format of before PyTorch 1.4"
        raise WeightsError(path, problem, _CONVERT_SCRIPT)
    if not any(name.endswith("data.pkl") for name in names):
        listed = ", ".join(sorted(names)[:5])
        raise WeightsError(
            path, f"is a zip archive of files ({listed})", "unpack it and import the state dict"
        )
    return any(name.endswith("/constants.pkl") for name in names)


class _Object:
    """Stands for a module of a TorchScript program: its attributes and nothing that they do."""

    attributes: dict[Any, Any] | None = None

    def __setstate__(self, state: Any) -> None:
        if isinstance(state, dict):
            self.attributes = state


_OPCODES = re.findall(
    r"\w+",
    "PROTO STOP MARK GLOBAL NEWOBJ REDUCE BUILD BINPERSID BINGET LONG_BINGET BINPUT LONG_BINPUT "
    "NONE NEWTRUE NEWFALSE BININT BININT1 BININT2 LONG1 BINFLOAT BINUNICODE EMPTY_TUPLE TUPLE "
    "TUPLE1 TUPLE2 TUPLE3 EMPTY_LIST APPEND APPENDS EMPTY_DICT SETITEM SETITEMS",
)
"""What PyTorch writes a TorchScript's attributes with."""

_STORAGES = {
    "FloatStorage": torch.float32,
    "DoubleStorage": torch.float64,
    "HalfStorage": torch.float16,
    "BFloat16Storage": torch.bfloat16,
    "LongStorage": torch.int64,
    "IntStorage": torch.int32,
    "ShortStorage": torch.int16,
    "CharStorage": torch.int8,
    "ByteStorage": torch.uint8,
    "BoolStorage": torch.bool,
}


class _Script:
    """The tensors of a TorchScript file.

    Args:
        content: Bytes of the zip file.

    Raises:
        ValueError: It is damaged, or written by a machine with another order of bytes.
    """

    def __init__(self, content: bytes) -> None:
        self._archive = zipfile.ZipFile(io.BytesIO(content))
        names = self._archive.namelist()
        (name,) = [name for name in names if re.fullmatch(r"[^/]*/data\.pkl", name)]
        self._folder = name.removesuffix("data.pkl")
        if f"{self._folder}byteorder" in names and self._part("byteorder").strip() != b"little":
            raise ValueError("its numbers are big-endian")
        self._pickled = self._part("data.pkl")
        self._storages: dict[str, bytearray] = {}

    def _part(self, name: str) -> bytes:
        """One file of the archive, which PyTorch writes as it is: a packed one may be a bomb."""
        entry = self._archive.getinfo(f"{self._folder}{name}")
        if entry.compress_type != zipfile.ZIP_STORED:
            raise ValueError(f"{name} is compressed")
        return self._archive.read(entry)

    def tensors(self) -> dict[str, Tensor]:
        """Parameters and buffers by their dotted names.

        Raises:
            pickle.UnpicklingError: It holds anything but modules, tensors and plain values.
            ValueError: It is damaged.
        """
        for opcode, argument, _ in pickletools.genops(self._pickled):
            if opcode.name not in _OPCODES:
                raise pickle.UnpicklingError(f"opcode {opcode.name}")
            if opcode.name == "LONG_BINPUT" and int(argument or 0) > len(self._pickled):
                raise ValueError("it numbers more objects than it has")
        found: dict[str, Tensor] = {}
        _collect(_Reader(io.BytesIO(self._pickled), self).load(), "", found)
        return found

    def storage(self, dtype: torch.dtype, key: str) -> tuple[torch.dtype, bytearray]:
        """The numbers of one storage."""
        if key not in self._storages:
            self._storages[key] = bytearray(self._part(f"data/{key}"))
        return dtype, self._storages[key]

    def tensor(
        self,
        storage: tuple[torch.dtype, bytearray],
        offset: int,
        size: tuple[int, ...],
        stride: tuple[int, ...],
        *_: Any,
    ) -> Tensor:
        """A tensor of its own, after checking that it lies within its storage."""
        dtype, numbers = storage
        count = len(numbers) // dtype.itemsize
        wanted = math.prod(size)
        last = offset + sum((n - 1) * step for n, step in zip(size, stride, strict=True))
        if min((offset, *size, *stride), default=0) < 0 or wanted > count:
            raise ValueError("a tensor is larger than what is stored of it")
        if not wanted:
            return torch.empty(size, dtype=dtype)
        if last >= count:
            raise ValueError("a tensor reaches beyond what is stored of it")
        return torch.frombuffer(numbers, dtype=dtype).as_strided(size, stride, offset).clone()


class _Reader(pickle.Unpickler):
    """Builds `_Object`, tensors and plain values; everything else is refused.

    Args:
        file: The pickled attributes.
        script: The file that they are of.
    """

    def __init__(self, file: io.BytesIO, script: _Script) -> None:
        super().__init__(file)
        self._script = script

    def find_class(self, module: str, name: str) -> Any:
        """What stands for a class or function that the file names."""
        if module == "__torch__" or module.startswith("__torch__."):
            return _Object
        if module == "torch" and name in _STORAGES:
            return _STORAGES[name]
        if module == "torch.jit._pickle" and name in (
            "restore_type_tag",
            "build_intlist",
            "build_doublelist",
            "build_boollist",
            "build_tensorlist",
        ):
            return self._first
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return self._script.tensor
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        raise pickle.UnpicklingError(f"GLOBAL {module}.{name}")

    def persistent_load(self, saved_id: Any) -> Any:
        """The storage that an id names."""
        kind, dtype, key, *_ = saved_id
        if kind != "storage" or not isinstance(key, str) or not isinstance(dtype, torch.dtype):
            raise pickle.UnpicklingError("an unknown reference")
        return self._script.storage(dtype, key)

    def _first(self, value: Any, *_: Any) -> Any:
        return value


def _collect(value: Any, name: str, found: dict[str, Tensor], depth: int = 0) -> None:
    """Add the tensors of a module and of the modules in it, in the order of the file."""
    if isinstance(value, Tensor):
        found[name] = value
    elif isinstance(value, _Object) and value.attributes is not None:
        if depth > 32:
            raise ValueError("its modules nest without end")
        for key, inner in value.attributes.items():
            if isinstance(inner, Tensor | _Object):
                _collect(inner, f"{name}.{key}" if name else str(key), found, depth + 1)


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0][:160] if str(error).strip() else type(error).__name__
