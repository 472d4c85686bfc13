"""`python -m metasense.records`: the command around `metasense.records.convert`."""

import argparse
import glob
import inspect
import sys
from collections.abc import Sequence

from metasense.records import convert


def _key(text: str) -> str | int:
    return int(text) if text.isdigit() else text


def _keys(text: str) -> list[str | int]:
    return [_key(part.strip()) for part in text.split(",")]


def _parser() -> argparse.ArgumentParser:
    assert convert.__doc__ is not None
    parser = argparse.ArgumentParser(
        prog="python -m metasense.records",
        description=inspect.cleandoc(convert.__doc__).replace("`", ""),
        epilog="Options are the arguments of convert, with dashes for underscores. Digits select a column by its number.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("files", nargs="+", metavar="FILE", help="files, or patterns such as 'raw/*.csv' in quotes")
    parser.add_argument("--signal-files", nargs="+", metavar="FILE")
    kinds = {"force": _keys, "signals": _keys, "time": _key, "signal_time": _key, "panel": _key}
    named = inspect.signature(convert).parameters
    for name in ["out", *(name for name, parameter in named.items() if parameter.kind is parameter.KEYWORD_ONLY)]:
        if name == "signal_files":
            continue
        kind = kinds.get(name) or next((k for k in (float, int) if k.__name__ in str(named[name].annotation)), str)
        parser.add_argument("--" + name.replace("_", "-"), type=kind, required=name in ("out", "force"), default=argparse.SUPPRESS)
    return parser


def _matched(patterns: Sequence[str]) -> list[str]:
    """The files of names and patterns, in order."""
    return [
        file for pattern in patterns for file in (sorted(glob.glob(pattern)) if glob.has_magic(pattern) else [pattern]) or [pattern]
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command. Exit code 2 and the reason if a file cannot be converted."""
    given = vars(_parser().parse_args(arguments))
    given["files"] = _matched(given["files"])
    given["signal_files"] = _matched(given["signal_files"]) if given["signal_files"] else None
    if given.get("delimiter") in ("tab", "\\t"):
        given["delimiter"] = "\t"
    try:
        toml, notes = convert(**given)
    except (ValueError, OSError, ImportError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for note in notes:
        print(f"note: {note}", file=sys.stderr)
    print(f"{toml}: for metasense lab identify and evaluate (--records)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
