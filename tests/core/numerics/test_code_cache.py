# SPDX-License-Identifier: Apache-2.0
"""Compiled code is loaded only from a folder that only this user can write, and only if it is intact."""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import pytest

from core.numerics.processes import COMPILED, CUBES, output, started
from fjr_core.numerics import code_cache
from fjr_core.numerics import jit as compiling

pytestmark = pytest.mark.usefixtures("cache")
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to another user")
NOBODY = 65534


def assert_compiled() -> None:
    x = ca.SX.sym("x", 3)
    made = compiling.compiled(ca.Function("cubes", [x], [x**3]))
    assert made.class_name() == "External"
    assert made([1, 2, 3]).full().ravel().tolist() == [1, 8, 27]


def plant_library(library: Path, marker: Path) -> None:
    """Replace the library by one of equal name and size that creates the marker file when loaded."""
    code = library.parent.parent / "planted.c"
    code.write_text(
        f'#include <stdio.h>\n__attribute__((constructor)) static void mark(void) {{ fclose(fopen("{marker}", "w")); }}'
    )
    made = code.with_suffix(".so")
    subprocess.run(["cc", "-shared", "-fPIC", "-Os", "-s", "-o", str(made), str(code)], check=True)
    size, content = library.stat().st_size, made.read_bytes()
    library.write_bytes(content.ljust(size, b"\0"))


def library_file(cache: Path, name: str = "cubes") -> Path:
    (found,) = cache.glob(f"{name}-*.so")
    return found


CERTIFICATE = """
import numpy as np, fjr_core as fjr
from fjr_core.monitoring.certificate import Certificate
certificate = Certificate(fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS, compile=True))
print(certificate.along([[0.1, 0.2]], [[0.0, 0.0]], np.zeros((1, 5, 1))).V[0] > 0)
"""


def test_a_planted_library_of_equal_name_and_size_is_not_run(cache: Path, tmp_path: Path) -> None:
    """Neither one that is found by its content nor one that is found by its inputs."""
    said = f"{COMPILED}\nTrue\n"
    assert output(started(CUBES + CERTIFICATE)) == said
    for name in ("cubes", "certificate"):
        plant_library(library_file(cache, name), tmp_path / f"{name}-ran")
    assert output(started(CUBES + CERTIFICATE)) == said
    assert not list(tmp_path.glob("*-ran"))


def replace_by_a_link(cache: Path) -> None:
    cache.rename(cache.with_name("elsewhere"))
    cache.symlink_to("elsewhere")


def replace_by_a_file(cache: Path) -> None:
    shutil.rmtree(cache)
    cache.touch()


SPOILT = [
    pytest.param(lambda cache: cache.chmod(0o777), id="writable by others"),
    pytest.param(lambda cache: cache.chmod(0o770), id="writable by the group"),
    pytest.param(lambda cache: os.chown(cache, NOBODY, -1), marks=as_root, id="of another user"),
    replace_by_a_link,
    replace_by_a_file,
]


@pytest.mark.parametrize("spoil", SPOILT)
def test_nothing_is_loaded_from_a_folder_that_is_not_private(
    spoil: Callable[[Path], None], cache: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A matching digest does not help, because whoever can write the library can write the digest."""
    assert_compiled()
    library, marker = library_file(cache), tmp_path / "marker"
    plant_library(library, marker)
    digest = hashlib.sha256(library.read_bytes()).hexdigest()
    library.with_name(f"{library.name}.sha256").write_text(digest)
    spoil(cache)
    caplog.clear()
    with caplog.at_level(logging.WARNING, "fjr_core.numerics.jit"):
        for _ in range(2):
            assert_compiled()
    assert not marker.exists()
    (sentence,) = caplog.messages
    assert str(cache) in sentence
    temporary = Path(os.environ["XDG_CACHE_HOME"])
    assert temporary.stat().st_mode & 0o777 == 0o700
    assert library_file(temporary / "fjr").exists()


def test_links_and_files_of_other_users_are_not_read(cache: Path, tmp_path: Path) -> None:
    folder = code_cache.open_private(cache)
    code_cache.write(folder / "mine", b"content")
    assert code_cache.read(folder / "mine") == b"content"
    (cache / "link").symlink_to(cache / "mine")
    os.mkfifo(cache / "pipe")
    (cache / "open").write_bytes(b"content")
    (cache / "open").chmod(0o666)
    if os.geteuid() == 0:
        (cache / "theirs").write_bytes(b"content")
        os.chown(cache / "theirs", NOBODY, -1)
    for name in ("link", "pipe", "open", "theirs", "none", "a\0b", "../outside"):
        (tmp_path / "cache" / "outside").symlink_to(cache / "mine") if name == "../outside" else None
        assert code_cache.read(folder / name) is None


def test_cache_folder_is_private_to_the_user(cache: Path) -> None:
    before = os.umask(0)
    try:
        assert_compiled()
    finally:
        os.umask(before)
    assert not any(path.stat().st_mode & 0o077 for path in (cache, *cache.iterdir()))


def test_folder_replaced_after_the_check_is_not_read(cache: Path, tmp_path: Path) -> None:
    """The replacement happens between check and use, by a user who can write the parent folder."""
    folder = code_cache.open_private(cache)
    code_cache.write(folder / "name", b"right")
    cache.rename(tmp_path / "moved")
    cache.mkdir()
    (cache / "name").write_bytes(b"wrong")
    assert code_cache.read(folder / "name") == b"right"


@as_root
def test_read_only_folder_is_read_and_new_code_goes_to_a_temporary_folder(cache: Path, tmp_path: Path) -> None:
    """The code runs as an unprivileged user, to whom file modes apply."""
    said = as_nobody(tmp_path, cache, CUBES + "import os\nos.chmod(os.environ['XDG_CACHE_HOME'] + '/fjr', 0o500)")
    assert said == as_nobody(tmp_path, cache, CUBES) == f"{COMPILED}\n"
    said = as_nobody(tmp_path, cache, CUBES.replace("cubes", "others"))
    assert COMPILED in said
    assert said.count("cannot write to") == 1


@as_root
def test_without_a_home_a_temporary_folder_is_used(cache: Path, tmp_path: Path) -> None:
    """The home of this user, of whom HOME says nothing, is /nonexistent."""
    said = as_nobody(tmp_path, cache, CUBES, {"XDG_CACHE_HOME": ""})
    assert COMPILED in said
    assert said.count("compiled code is kept in") == 1
    assert not list((tmp_path / "tmp").iterdir())  # removed at the end


def as_nobody(tmp_path: Path, cache: Path, code: str, variables: dict[str, str] | None = None) -> str:
    """Run code in Python as another user, who owns cache and temporary folder; return its output."""
    for folder in (cache.parent, tmp_path / "tmp"):
        if not folder.exists():
            folder.mkdir()
            os.chown(folder, NOBODY, NOBODY)
    tmp_path.chmod(0o755)
    for folder in tmp_path.parents:
        if folder.stat().st_uid == os.geteuid() and not folder.stat().st_mode & 0o001:
            folder.chmod(folder.stat().st_mode | 0o011)  # the folders of pytest are private to its user
    environment = {name: value for name, value in os.environ.items() if name not in ("HOME", "XDG_CACHE_HOME")}
    environment |= {"XDG_CACHE_HOME": str(cache.parent), "TMPDIR": str(tmp_path / "tmp"), **(variables or {})}
    readable = tmp_path / "source"  # the checkout may be in root's own folder
    shutil.copytree(compiling.PACKAGE, readable / compiling.PACKAGE.name, dirs_exist_ok=True)
    environment["PYTHONPATH"] = os.pathsep.join([str(readable), *sys.path])
    become = f"import os, casadi, fjr_core.numerics.jit\nos.setgroups([]); os.setgid({NOBODY}); os.setuid({NOBODY})\n"
    result = subprocess.run(
        [sys.executable, "-c", become + code], env=environment, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout + result.stderr
