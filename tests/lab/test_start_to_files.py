"""Programs that are timed from their start to their files."""

from __future__ import annotations

import pytest

from warp_partdr.errors import InputError
from warp_partdr.lab.measurements.start_to_files import _run


def test_programs_keep_their_compiled_modules_whatever_this_process_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without them, each start would compile all sources anew, which users' starts do not."""
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    assert _run(("-c", "import sys; sys.exit(sys.dont_write_bytecode)")).wall > 0
    with pytest.raises(InputError, match="exit code 3"):
        _run(("-c", "import sys; sys.exit(3)"))
