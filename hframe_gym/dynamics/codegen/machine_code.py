"""Turn LLVM's intermediate representation into machine code of this processor, and keep the code on disk.

An object file is kept in the cache folder under the hash of everything that it depends on. Loading it takes a
millisecond, compiling it a tenth of a second.
"""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numba
from llvmlite import ir

from ...files import atomic_file, cache_folder

_LOCK = threading.RLock()
_LOADED: dict[str, Any] = {}  # engines by the hash of their code, which exists as long as they do


def processor() -> tuple[str, str]:
    """Return the processor's name and features (comma-separated, as in LLVM) for which code is compiled.

    Numba determines them, where NUMBA_CPU_NAME and NUMBA_CPU_FEATURES replace what LLVM finds.
    """
    name, features = numba.config.CPU_NAME, numba.config.CPU_FEATURES  # type: ignore[attr-defined]
    return name or llvm.get_host_cpu_name(), (
        llvm.get_host_cpu_features().flatten() if features is None else str(features)
    )


# Machines per SIMD register. With AVX-512, a register is two of the processor: instructions on one run while
# those on the other wait for their results. Other processors have too few registers for 16 numbers per
# variable.
LANES = 16 if "+avx512f" in processor()[1].split(",") else 8


def native_functions(key: str, names: Sequence[str], build: Callable[[], ir.Module]) -> Mapping[str, int]:
    """Load machine code from the cache, or compile it, and return the addresses of its functions by name.

    Args:
        key: Text that identifies the source code; the cache distinguishes code by it and by the processor.
        names: Names of the functions.
        build: Called to generate the code's intermediate representation (LLVM), if the cache lacks it. The
            compiled code is then written to the cache folder.
    """
    text = "\n".join((key, llvmlite.__version__, llvm.get_default_triple(), *processor()))
    name = f"kernel_{hashlib.sha256(text.encode()).hexdigest()[:24]}"
    with _LOCK:
        if name not in _LOADED:
            path = cache_folder() / f"{name}.o"
            code = path.read_bytes() if path.exists() else b""
            if not code:
                code = _compile(build())
                with atomic_file(path) as file:
                    file.write(code)
            _LOADED[name] = _load(code)
        return {function: _LOADED[name].get_function_address(function) for function in names}


def _target_machine() -> Any:
    """Return a description of the processor for LLVM."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    cpu, features = processor()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(cpu=cpu, features=features, opt=3, codemodel="jitdefault", jit=True)


def _compile(module: ir.Module) -> bytes:
    """Optimize a module; return its object code."""
    machine = _target_machine()
    module.triple = llvm.get_default_triple()
    module.data_layout = str(machine.target_data)
    parsed = llvm.parse_assembly(str(module))
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    builder.getModulePassManager().run(parsed, builder)
    return bytes(machine.emit_object(parsed))


def _load(code: bytes) -> Any:
    """Load object code into this process with MCJIT, which Numba uses on all systems; return its engine."""
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine
