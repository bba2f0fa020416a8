"""Signatures of checkpoints, so that a training run resumes only from files of this installation.

A checkpoint of stable-baselines3 is a pickle, which executes code when it is loaded. Training signs its
checkpoints with a secret key of this installation, and only a signed checkpoint is loaded unless the user
trusts it.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import secrets
from pathlib import Path

from ..errors import InputError
from ..operating_system import user_folder

KEY_BYTES = 32
_MARK = b"\nhframe_gym checkpoint signature "
_TRAILER = len(_MARK) + 2 * KEY_BYTES  # a pickle and a zip archive may have further bytes at the end


def sign_checkpoint(path: Path) -> None:
    """Append a signature to a checkpoint, by which `refuse_unsigned` recognizes files of this installation.

    The signature is a keyed hash (HMAC-SHA256) of the file with a secret key of this installation. If the key
    cannot be stored, because its folder is read-only, the file is not changed. The file is a pickle or a zip
    archive; both can be loaded with further bytes at their end.
    """
    try:
        key = _installation_key()
    except OSError:
        return
    signature = _signature(path, path.stat().st_size, key)
    with open(path, "ab") as file:
        file.write(_MARK + signature)
        file.flush()
        os.fsync(file.fileno())


def refuse_unsigned(path: Path) -> None:
    """Raise an error unless this installation wrote a checkpoint and nothing has changed it since.

    Call it before loading a checkpoint, because loading executes code that the file contains.

    Raises:
        InputError: If the file has no signature, or one of another installation, or was changed since.
    """
    size = path.stat().st_size - _TRAILER
    with open(path, "rb") as file:
        file.seek(max(size, 0))
        trailer = file.read()
    try:
        key = _installation_key(create=False)
    except OSError:
        key = b""
    valid = key and size >= 0 and trailer.startswith(_MARK)
    if not valid or not hmac.compare_digest(trailer[len(_MARK) :], _signature(path, size, key)):
        raise InputError(
            f"{path}: was not written by this installation, and loading "
            "it can execute code that it contains; if you trust its origin, add --trust"
        )


def key_file() -> Path:
    """Return the path of the secret key of `sign_checkpoint`, checkpoint.key in the user's data folder."""
    return user_folder("data") / "hframe_gym" / "checkpoint.key"


def _installation_key(*, create: bool = True) -> bytes:
    """Return the key, which only this user can read; make it at first use."""
    path = key_file()
    if create:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
                file.write(secrets.token_bytes(KEY_BYTES))
        except FileExistsError:
            pass
    key = path.read_bytes()
    if len(key) != KEY_BYTES:
        raise OSError(f"{path} is damaged; delete it")
    return key


def _signature(path: Path, size: int, key: bytes) -> bytes:
    """Return the signature of the first bytes of a file as hexadecimal digits."""
    digest = hmac.new(key, digestmod=hashlib.sha256)
    with open(path, "rb") as file:
        while size > 0 and (block := file.read(min(size, 1 << 20))):
            digest.update(block)
            size -= len(block)
    return digest.hexdigest().encode()
