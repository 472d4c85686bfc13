"""The build backend: maturin's, with the program beside the module.

maturin builds a module or a program, not both. The program has to be one file of its own: it starts its workers as
itself (/proc/self/exe), which a console script inside an interpreter is not. So it is built first, by the same cargo with
the same features, which compiles everything that the module needs, and goes into the wheel's scripts.
"""

import os
import shlex
import shutil
import subprocess
from pathlib import Path
from typing import Any

import maturin
from maturin import get_requires_for_build_editable, get_requires_for_build_sdist, get_requires_for_build_wheel  # noqa: F401

ROOT = Path(__file__).parents[2]
SCRIPTS = Path(__file__).parent / "metasense.data" / "scripts"


def add_program() -> None:
    """Builds the `metasense` command in the profile of MATURIN_PEP517_ARGS, `release` by default."""
    arguments = shlex.split(os.environ.get("MATURIN_PEP517_ARGS", ""))
    profile = arguments[arguments.index("--profile") + 1] if "--profile" in arguments else "release"
    command = ["cargo", "build", "--locked", "--profile", profile, "--bin", "metasense"]
    features = ["-p", "metasense", "-p", "metasense-python", "--features", "metasense-python/extension"]
    subprocess.run([*command, *features], cwd=ROOT, check=True)
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    built = target / ("debug" if profile == "dev" else profile) / "metasense"
    SCRIPTS.mkdir(parents=True, exist_ok=True)
    shutil.copy2(built, SCRIPTS / "metasense")
    if shutil.which("strip"):
        subprocess.run(["strip", SCRIPTS / "metasense"], check=True)


def build_wheel(folder: str, settings: Any = None, metadata: str | None = None) -> str:
    add_program()
    return maturin.build_wheel(folder, settings, metadata)


def build_editable(folder: str, settings: Any = None, metadata: str | None = None) -> str:
    add_program()
    return maturin.build_editable(folder, settings, metadata)


def build_sdist(folder: str, settings: Any = None) -> str:
    SCRIPTS.mkdir(parents=True, exist_ok=True)  # maturin requires the folder
    return maturin.build_sdist(folder, settings)
