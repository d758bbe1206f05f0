"""Threads of linear algebra while a verb runs."""

from threadpoolctl import threadpool_info, threadpool_limits

from ident.show.progress import watched
from ident.threads import VARIABLES


def threads() -> set[int]:
    return {library["num_threads"] for library in threadpool_info()}


def test_a_verb_runs_on_one_thread_and_gives_the_others_back(monkeypatch):
    for variable in VARIABLES:
        monkeypatch.delenv(variable, raising=False)
    verb = watched(lambda *, progress=None: threads())
    with threadpool_limits(2):
        usual = threads()
        assert verb() == {1}
        assert verb(progress=print) == {1}
        assert threads() == usual
