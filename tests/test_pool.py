"""Work spread over processes: what an interruption says."""

import os
import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="needs SIGINT")

SPREAD = """
import signal
import time

from tissue_contact.pool import pool

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.{handler})  # whatever the tests were started with
    try:
        with pool(2) as spread:
            {begin}
            spread(time.sleep, [{first}, {rest}, {rest}], lambda n, result: {done})
        print("done")
    except KeyboardInterrupt:
        print("interrupted")
"""
TELL = 'print("begun", flush=True)'


def _interrupt(folder, after=0.0, **parts):
    """What is told by processes that are all interrupted, as by Ctrl+C in a terminal, [s] after they have begun."""
    script = folder / "spread.py"
    script.write_text(SPREAD.format(**parts))
    with subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as run:
        assert run.stdout.readline() == "begun\n"
        time.sleep(after)
        os.killpg(run.pid, signal.SIGINT)
        return run.communicate(timeout=30)


def test_workers_that_are_interrupted_while_they_start_end_without_a_word(tmp_path):
    told = _interrupt(tmp_path, 0.2, handler="default_int_handler", begin=TELL, first=60.0, rest=60.0, done="None")
    assert told == ("interrupted\n", "")


def test_workers_that_are_interrupted_while_they_work_end_without_a_word(tmp_path):
    told = _interrupt(tmp_path, handler="default_int_handler", begin="", first=0.0, rest=60.0, done=TELL)
    assert told == ("interrupted\n", "")


def test_workers_go_on_where_interruptions_are_ignored(tmp_path):
    """As in the background of a script, whose processes get the Ctrl+C of its terminal as well."""
    told = _interrupt(tmp_path, handler="SIG_IGN", begin="", first=0.0, rest=1.0, done=f"n or {TELL}")
    assert told == ("done\n", "")
