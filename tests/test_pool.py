"""Work spread over processes: what an interruption says."""

import os
import signal
import subprocess
import sys
import time

import pytest

SPREAD = """
import time

from tissue_contact.pool import pool

if __name__ == "__main__":
    try:
        with pool(2) as spread:
            {begin}
            spread(time.sleep, [{first}, 60.0, 60.0], lambda n, result: {done})
    except KeyboardInterrupt:
        print("interrupted")
"""


@pytest.mark.skipif(os.name == "nt", reason="needs SIGINT")
@pytest.mark.parametrize("starting", [True, False])
def test_interrupted_workers_end_without_a_word(tmp_path, starting):
    """As with Ctrl+C, which all processes of a terminal get: while the workers start, and while they work."""
    script = tmp_path / "spread.py"
    tell = 'print("begun", flush=True)'
    begin, first, done = (tell, 60.0, "None") if starting else ("", 0.0, tell)
    script.write_text(SPREAD.format(begin=begin, first=first, done=done))
    with subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as run:
        assert run.stdout.readline() == "begun\n"
        time.sleep(0.2 if starting else 0.0)
        os.killpg(run.pid, signal.SIGINT)
        told = run.communicate(timeout=30)
    assert told == ("interrupted\n", "")
