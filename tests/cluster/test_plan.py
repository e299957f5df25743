"""Which files are decoded together, and what names their results."""

from __future__ import annotations

from mbtool.cluster.plan import (
    MAX_FILES,
    MAX_NEAR,
    MAX_RUN_BYTES,
    MIN_FILES,
    NEAR_BYTES,
    Around,
    FileRun,
    InputFile,
    files_each,
    parquet_name,
    path_name,
    plan,
    record_name,
    remaining,
    share_of,
)


def file(path: str, size: int = 100) -> InputFile:
    return InputFile(path, size, 7)


def paths(runs: list[FileRun]) -> list[list[str]]:
    return [[one.path for one in run.files] for run in runs]


def test_numbers_of_a_rotated_capture_are_counted_not_spelled() -> None:
    runs = plan([file("a/cap10.pcap"), file("a/cap9.pcap"), file("a/cap1.pcap")])
    assert paths(runs) == [["a/cap1.pcap", "a/cap9.pcap", "a/cap10.pcap"]]


def test_a_capture_goes_on_in_the_folder_of_the_next_day() -> None:
    named = "s3://b/site-7/2026-11-22/23.pcap", "s3://b/site-7/2026-11-23/00.pcap"
    assert paths(plan(map(file, named))) == [[*named]]
    parted = "b/7/2026/12/31/23.pcap", "b/7/2027/01/01/00.pcap"
    assert paths(plan(map(file, parted))) == [[*parted]]


def test_sites_and_names_of_other_letters_are_captures_of_their_own() -> None:
    named = ["b/site-1/0.pcap", "b/site-2/0.pcap", "b/site-2/left-0.pcap"]
    assert paths(plan(map(file, named))) == [[one] for one in named]


def test_a_file_knows_the_files_around_it_also_those_of_other_runs() -> None:
    files = [file(f"a/{number}.pcap") for number in range(5)]
    first, second = plan(files, 3)
    assert first.around[0] == Around((), (*files[1:],))
    assert second.around[0] == Around((*files[:3],), (files[4],))
    assert second.around[1] == Around((*files[:4],), ())


def test_around_a_large_file_one_is_read_and_of_small_ones_some() -> None:
    sizes = {3: NEAR_BYTES, 6: NEAR_BYTES}
    files = [file(f"a/{number}.pcap", sizes.get(number, 1)) for number in range(20)]
    (run,) = plan(files, 20)
    assert run.around[4] == Around((files[3],), (files[5], files[6]))
    assert run.around[5] == Around((files[3], files[4]), (files[6],))
    assert run.around[19] == Around((*files[19 - MAX_NEAR : 19],), ())


def test_a_run_ends_behind_the_file_that_makes_it_large() -> None:
    sizes = (MAX_RUN_BYTES - 1, 1, 1)
    runs = plan(file(f"a/{number}.pcap", size) for number, size in enumerate(sizes))
    assert [len(run.files) for run in runs] == [2, 1]


def test_a_file_that_is_named_twice_is_decoded_once() -> None:
    assert paths(plan([file("a/1.pcap"), file("a/1.pcap")])) == [["a/1.pcap"]]


def test_runs_are_short_for_few_files_and_bounded_for_many() -> None:
    assert files_each(8, 2) == MIN_FILES
    assert files_each(80, 2) == 10
    assert files_each(240_000, 2) == MAX_FILES


def test_what_remains_of_a_run_are_the_stretches_that_are_not_done() -> None:
    files = [file(f"a/{number}.pcap") for number in range(5)]
    (run,) = plan(files)
    left = remaining(run, lambda one, _: one in (files[0], files[3]))
    assert left == [
        FileRun((files[1], files[2]), run.around[1:3]),
        FileRun((files[4],), run.around[4:]),
    ]
    assert remaining(run, lambda *_: True) == []


def test_a_record_is_another_if_the_file_those_around_it_or_the_options_change() -> None:
    one, before = file("a/1.pcap"), file("a/0.pcap")
    names = {
        record_name(one, Around((before,), ()), "502"),
        record_name(file("a/1.pcap", 101), Around((before,), ()), "502"),
        record_name(one, Around((file("a/0.pcap", 101),), ()), "502"),
        record_name(one, Around((), ()), "502"),
        record_name(one, Around((), (before,)), "502"),
        record_name(one, Around((before,), ()), "1502"),
    }
    assert len(names) == 6
    assert {name.partition("-")[0] for name in names} == {path_name("a/1.pcap")}


def test_equal_bytes_under_two_names_give_two_parquet_files() -> None:
    assert parquet_name("a/1.pcap", "ff") == parquet_name("b/1.pcap", "ff")
    assert parquet_name("a/1.pcap", "ff") != parquet_name("a/2.pcap", "ff")


def test_each_run_is_in_one_share_whatever_else_is_listed() -> None:
    runs = plan(file(f"site-{site}/{number}.pcap") for site in range(30) for number in range(3))
    shares = [share_of(run, 4) for run in runs]
    assert {*shares} == {0, 1, 2, 3}
    assert [share_of(run, 4) for run in runs[:5]] == shares[:5]
