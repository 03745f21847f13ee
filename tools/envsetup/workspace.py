# SPDX-License-Identifier: Apache-2.0
"""Build ros2_ws by colcon, from nothing if its inputs have changed: colcon is as fast then, and leaves no old file.

Packages are linked, not copied (`--symlink-install`): an edited module or YAML file needs no build. A new,
removed or renamed file, a changed setup.py, setup.cfg or package.xml, another environment or Python does.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from envsetup.commands import run
from envsetup.environment import Environment, fingerprint, read_stamp, texts, write_stamp

COPIED = {"setup.py", "setup.cfg", "package.xml"}
"""Files whose contents enter the build."""
OTHER = re.compile(r"build|\..*|__pycache__.*|.*(\.egg-info|\.pyc|~)", re.DOTALL)
"""Names of files and folders that belong to no package."""
COLCON = "import sys; from colcon_core.command import main; sys.exit(main())"
OPTIONS = ("build", "--symlink-install", "--base-paths", "src", "--event-handlers")
EVENTS = ("console_cohesion+", "desktop_notification-", "terminal_title-", "status-")

UNQUOTED = re.compile(r"^(_colcon\w*_COLCON_CURRENT_PREFIX=)(/.*)$", re.MULTILINE)
CALL = re.compile(r"\$\(\$_colcon_python_executable ")
FIRST_LINE = re.compile(rb'^#!\s*"?(?P<python>/[^"\n]* [^"\n]*?)"?(?: -x)?\n')


class Workspace:
    """ros2_ws of the checkout, built for one environment."""

    def __init__(self, environment: Environment) -> None:
        self.environment = environment
        self.path = environment.root / "ros2_ws"
        self.install = self.path / "install"
        self._stamp = self.install / ".complete.json"

    def ensure(self) -> None:
        """Build anew unless the last build is up to date."""
        wanted = {"content": self.content()}
        if read_stamp(self._stamp) == wanted and (self.path / "build").is_dir():
            return
        for folder in ("build", "install", "log"):
            shutil.rmtree(self.path / folder, ignore_errors=True)
        self._build()
        write_stamp(self._stamp, wanted)

    def content(self) -> str:
        """Return the fingerprint of environment and packages: list of files, and contents that colcon reads."""
        files = source_files(self.path / "src")
        contents = {str(path): path.read_text(encoding="utf-8") for path in files if path.name in COPIED}
        identity = [str(self.path), *self.environment.identity()]
        return fingerprint(identity, [str(path) for path in files], contents, texts([Path(__file__)]))

    def _build(self) -> None:
        """Run colcon in the Python of the environment, which becomes the interpreter of the nodes.

        Compile the packages to bytecode, so that the first start is as fast as the next one.
        """
        python, env = str(self.environment.python), self.environment.env
        log = self.environment.root / ".setup" / "colcon.log"
        log.unlink(missing_ok=True)
        colcon = [python, "-c", COLCON, *OPTIONS, *EVENTS]
        run("colcon build of ros2_ws", colcon, log, env, "colcon could not build ros2_ws", cwd=self.path)
        quote_paths(self.install)
        folders = [str(file.parent) for file in sorted((self.path / "src").glob("*/*/__init__.py"))]
        run("bytecode of ros2_ws", [python, "-m", "compileall", "-q", *folders], log, env, "a module is no Python")


def source_files(folder: Path) -> list[Path]:
    """Return all package files under `folder`, sorted, without caches, builds and hidden files."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return [path for path in files if not any(map(OTHER.fullmatch, path.relative_to(folder).parts))]


def quote_paths(install: Path) -> None:
    """Quote the paths in the scripts of an install folder, so that they work from a checkout whose path has spaces.

    colcon writes the path unquoted in setup.sh, and the path of Python in local_setup.*. setuptools writes the latter
    into the first line of the nodes, which the kernel splits at the first space.
    """
    for script in [path for form in ("*.sh", "*.bash", "*.zsh") for path in install.rglob(form)]:
        text = script.read_text(encoding="utf-8")
        quoted = CALL.sub('$("$_colcon_python_executable" ', UNQUOTED.sub(_quoted, text))
        if quoted != text:
            script.write_text(quoted, encoding="utf-8")
    executables = [path for path in install.glob("*/lib*/*/*") if path.parent.name == path.parents[2].name]
    for executable in filter(Path.is_file, executables):  # <package>/lib/<package>, <package>/libexec/<package>
        content = executable.read_bytes()
        started = FIRST_LINE.sub(_by_the_shell, content)
        if started != content:
            executable.write_bytes(started)


def _quoted(line: re.Match[str]) -> str:
    path = line[2].strip('"').replace("'", "'\\''")
    return f"{line[1]}'{path}'"


def _by_the_shell(line: re.Match[bytes]) -> bytes:
    """Return two lines that sh executes as `exec python` and Python ignores as a string."""
    return b"#!/bin/sh\n'''exec' \"" + line["python"] + b'" "$0" "$@"\n\' \'\'\'\n'
