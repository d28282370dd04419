"""Reading and writing the project's own small files.

They are capped before parsing, checked, and written whole or not at all.
"""

import hashlib
import os
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from toolkit.errors import ConfigError, EnvironmentFault

MAX_TOML_BYTES = 4 * 1024 * 1024


def read_toml(path: Path, kind: str) -> dict[str, Any]:
    """Read a TOML file whose `schema` is "toolkit.<kind>/1"; the schema key itself is taken out.

    Raises:
        ConfigError: when the file is missing, too large, not TOML or of another schema.
    """
    try:
        if path.stat().st_size > MAX_TOML_BYTES:
            raise ConfigError(f"{path} is larger than {MAX_TOML_BYTES} bytes; is it a {kind} file?")
        table = tomllib.loads(path.read_bytes().decode("utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path} does not exist; give the path of a {kind} file") from None
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be read ({error.strerror}); give the path of a {kind} file"
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{path} is not valid TOML ({one_line(error)}); correct or recreate it"
        ) from None
    schema = table.pop("schema", None)
    if schema != f"toolkit.{kind}/1":
        raise ConfigError(
            f'{path} has schema {schema!r}; a {kind} file has schema = "toolkit.{kind}/1"'
        )
    return table


def check_keys(
    where: str, table: Mapping[str, Any], allowed: Mapping[str, type | tuple[type, ...]]
) -> None:
    """Raise `ConfigError` naming the first key that is unknown or has a value of another type.

    An integer passes for a float; a bool never passes for a number.
    """
    for key, value in table.items():
        if key not in allowed:
            raise ConfigError(f"{where}: unknown key '{key}'; known are {', '.join(allowed)}")
        wanted = allowed[key]
        kinds = wanted if isinstance(wanted, tuple) else (wanted,)
        is_number = float in kinds and isinstance(value, int)
        is_stray_bool = isinstance(value, bool) and bool not in kinds
        if is_stray_bool or not (isinstance(value, kinds) or is_number):
            names = " or ".join(kind.__name__ for kind in kinds)
            raise ConfigError(f"{where}: '{key}' is {value!r}; a {names} is needed")


@contextmanager
def write_whole(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`, renamed onto it when the block ends well, else removed.

    The temporary name keeps the suffix, so that writers that choose the format by it still work.

    Raises:
        EnvironmentFault: when the folder is missing or read-only, or the disk is full.
    """
    temporary: Path | None = None
    try:
        handle, name = tempfile.mkstemp(
            prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent
        )
        os.close(handle)
        temporary = Path(name)
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
        temporary = None
    except OSError as error:
        reason = error.strerror or one_line(error)
        raise EnvironmentFault(
            f"{path} cannot be written ({reason}); choose another place or make room"
        ) from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write `text` as UTF-8, whole or not at all."""
    with write_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def sha256(path: Path) -> str:
    """Hash a file's contents."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def one_line(error: BaseException) -> str:
    """Fold an error's text onto one line of at most 200 characters."""
    return " ".join(str(error).split())[:200] or type(error).__name__
