"""Files: written whole or not at all, read within limits, and generated code in a cache."""

from .atomic import (
    STAGE,
    atomic_file,
    complete_commit,
    locked_folder,
    newest,
    output_batch,
    remove_file,
    scratch_folder,
    write_text,
)
from .cache import cache_folder
from .limits import (
    MAX_LINE,
    expansion_limit,
    read_arrays,
    read_document,
    read_json,
    refuse_expansion,
    refuse_long_line,
    refuse_many_values,
)
from .outputs import files_of, output_folder, write_files

__all__ = [
    "MAX_LINE",
    "STAGE",
    "atomic_file",
    "cache_folder",
    "complete_commit",
    "expansion_limit",
    "files_of",
    "locked_folder",
    "newest",
    "output_batch",
    "output_folder",
    "read_arrays",
    "read_document",
    "read_json",
    "refuse_expansion",
    "refuse_long_line",
    "refuse_many_values",
    "remove_file",
    "scratch_folder",
    "write_files",
    "write_text",
]
