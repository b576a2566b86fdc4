"""Names, files and logs are UTF-8, whatever the locale says: a command in another one starts again as that."""

import os
import sys


def speak_utf8() -> None:
    """Starts this Python again in its UTF-8 mode (PEP 540), if it is not in it and what it was given is UTF-8.

    In a locale of another encoding, such as C without coercion or ISO 8859-1, Python would take the bytes of a name for other
    letters, or for none, and could not name a file as a vehicle file does. What it was given in that encoding stays as it
    is. Where nothing but ASCII was given, output stays in the terminal's encoding: what that lacks is escaped.

    To be called before anything has begun.
    """
    if sys.getfilesystemencoding() == "utf-8" or os.environ.get("PYTHONUTF8") == "1" or sys.flags.ignore_environment:
        return
    given = b"".join(map(os.fsencode, sys.orig_argv))
    try:
        given.decode("utf-8")
    except UnicodeDecodeError:
        return
    environment = {**os.environ, "PYTHONUTF8": "1"}
    if given.isascii() and sys.stdout is not None:  # closed, as in `>&-`
        environment.setdefault("PYTHONIOENCODING", f"{sys.stdout.encoding}:backslashreplace")
    os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], environment)
