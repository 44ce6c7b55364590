"""A data set of LeRobot: what its info.json says, its episodes, and the files they are in (v2.1 and v3.0)."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from kilter_files.formats.reader import ZIP, of_zip
from kilter_files.ground.errors import fault, read_head
from kilter_files.ground.later import need, pa, parquet

INSIDE = (b"moov", b"trak", b"mdia", b"minf", b"stbl")
REMEDY = "It was cut off: record it again, or take the episode out of the data set."


@dataclass(frozen=True)
class Film:
    """Pictures of a video, and for how long they run; 0 s where the file does not say."""

    pictures: int
    seconds: float


def read_video_track(path: Path) -> Film:
    """Return what the first track of video holds.

    Raises:
        FileError: no index, as of a file that was not finished.

    """
    with path.open("rb") as stream:
        size = path.stat().st_size
        moov = next((at for kind, *at in _boxes(stream, 0, size) if kind == b"moov"), None)
        if moov is None:
            raise fault(path, "is an MP4 file without an index", REMEDY)
        for kind, start, end in _boxes(stream, *moov):
            if kind == b"trak" and _handler(stream, start, end) == b"vide":
                count = _samples(stream, start, end)
                if count is not None:
                    return Film(count, _seconds(stream, start, end))
    raise fault(path, "holds no track of video", REMEDY)


def _boxes(stream: BinaryIO, start: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Kind, and where the content begins and ends."""
    while start + 8 <= end:
        stream.seek(start)
        size, kind = struct.unpack(">I4s", stream.read(8))
        head = 8
        if size == 1:
            size, head = struct.unpack(">Q", stream.read(8))[0], 16
        elif size == 0:
            size = end - start
        if size < head or start + size > end:
            return
        yield kind, start + head, start + size
        start += size


def _find(stream: BinaryIO, start: int, end: int, wanted: bytes) -> tuple[int, int] | None:
    for kind, first, last in list(_boxes(stream, start, end)):
        if kind == wanted:
            return first, last
        if kind in INSIDE:
            found = _find(stream, first, last, wanted)
            if found is not None:
                return found
    return None


def _handler(stream: BinaryIO, start: int, end: int) -> bytes:
    at = _find(stream, start, end, b"hdlr")
    if at is None:
        return b""
    stream.seek(at[0] + 8)
    return stream.read(4)


def _samples(stream: BinaryIO, start: int, end: int) -> int | None:
    at = _find(stream, start, end, b"stsz")
    if at is None:
        return None
    stream.seek(at[0] + 8)
    return int(struct.unpack(">I", stream.read(4))[0])


def _seconds(stream: BinaryIO, start: int, end: int) -> float:
    """Duration of a track by its media header, whose second version has longer numbers."""
    at = _find(stream, start, end, b"mdhd")
    if at is None:
        return 0.0
    stream.seek(at[0])
    longer = stream.read(4)[:1] == b"\1"
    stream.seek(at[0] + (20 if longer else 12))
    form = ">IQ" if longer else ">II"
    ticks, duration = struct.unpack(form, stream.read(struct.calcsize(form)))
    return float(duration / ticks) if ticks else 0.0


INFO, EPISODES_JSONL, EPISODES = "meta/info.json", "meta/episodes.jsonl", "meta/episodes"
STATE, ACTION = "observation.state", "action"
OLD, NEW = "v2.1", "v3.0"
FINISH = "It is half written: finish the recording (lerobot-record ends it by itself), or copy it again."
FOLDER = "Give the folder of a LeRobot data set, the one with meta/info.json."
NOT_OF_ONE_TIME = "Leave the episode out, or record it again: pictures and joints are not of one time."
SLACK_PICTURES, SLACK_SHARE = 1.5, 0.01  # how long the last picture is shown is left to whoever writes the file
NAMES_OF_LISTS = ("motors", "axes")  # under which older data sets name the numbers of a column


@dataclass(frozen=True)
class Episode:
    """An episode: its rows, the file that has them, and of each camera the file that has its pictures.

    ``spans_s`` are the seconds between which each camera's pictures are in their file, where the data set says (v3.0).
    """

    index: int
    length: int
    data: str
    videos: Mapping[str, str]
    spans_s: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Dataset:
    """A data set: its folder, version, frames per second, robot, names of the recorded joints, and episodes.

    ``has_actions`` says whether it has what the same joints were told.
    """

    folder: Path
    version: str
    fps: float
    robot_type: str
    names: tuple[str, ...]
    episodes: tuple[Episode, ...]
    frames: int
    has_actions: bool = False

    @property
    def summary_text(self) -> str:
        """Its version, episodes and robot, for people."""
        return f"LeRobot {self.version}, {len(self.episodes)} episodes of {self.robot_type or 'an unknown robot'}"

    def rows_of_files(self) -> dict[str, int]:
        """How many rows each file of rows has by its episodes, in the order of the files."""
        return _row_count_by_file((episode.data, episode.length) for episode in self.episodes)


def open_dataset(path: Path) -> Dataset:
    """Read what a data set says of itself; ``path`` is its folder or its info.json.

    Raises:
        FileError: another file, a version that is not known, no recorded joints, or parts that are not there.

    """
    if path.is_file() and path.name != Path(INFO).name:
        raise of_zip(path) if read_head(path, len(ZIP)) == ZIP else fault(path, "is not a LeRobot data set", FOLDER)
    folder = path if path.is_dir() else path.resolve().parent.parent
    info = _info(folder)
    version = str(info.get("codebase_version"))
    if version not in (OLD, NEW):
        raise fault(folder / INFO, f"is of version {version!r}", f"{OLD} and {NEW} are read: convert it with LeRobot.")
    state = (info.get("features") or {}).get(STATE)
    if not isinstance(state, dict):
        has = ", ".join(info.get("features") or {})
        raise fault(folder / INFO, f"has no {STATE} ({has})", "A joint log is what the follower's servos read.")
    episodes = tuple(_episodes_v21(folder, info) if version == OLD else _episodes_v30(folder, info))
    _refuse_missing(folder, info, episodes)
    names = _names(state)
    if not names:
        raise fault(folder / INFO, f"does not name the numbers of {STATE}", "Write their names into the file.")
    frames = sum(episode.length for episode in episodes)
    told = _names(info["features"].get(ACTION)) == names
    robot = str(info.get("robot_type") or "")
    return Dataset(folder, version, float(info["fps"]), robot, names, episodes, frames, told)


def parquet_file(path: Path) -> parquet.ParquetFile:
    """Open a file of rows.

    Raises:
        FileError: it is missing or was not finished.

    """
    need(f"{path}: data sets of LeRobot need", "pyarrow")
    try:
        return parquet.ParquetFile(path)
    except FileNotFoundError as error:
        raise fault(path, "is missing", FINISH) from error
    except (pa.ArrowInvalid, OSError) as error:
        raise fault(path, "is not a whole Parquet file", FINISH) from error


def refuse_unfinished(dataset: Dataset) -> None:
    """Compare the rows of each file and the pictures of each video with the episodes; no row is read.

    Raises:
        FileError: a file is missing or cut, or has more or fewer than its episodes.

    """
    for name, expected in dataset.rows_of_files().items():
        found = parquet_file(dataset.folder / name).metadata.num_rows
        if found != expected:
            raise fault(dataset.folder / name, f"has {found} rows, its episodes have {expected}", FINISH)
    refuse_short_videos(dataset)


def refuse_short_videos(dataset: Dataset) -> None:
    """Compare the pictures of each video, and what the data set says of them, with the rows that they belong to.

    Raises:
        FileError: a video is missing, has more or fewer pictures than its episodes have rows, or runs for another time.

    """
    rows = _row_count_by_file(
        (video, episode.length) for episode in dataset.episodes for video in episode.videos.values()
    )
    for video, expected in rows.items():
        path = dataset.folder / video
        if not path.is_file():
            raise fault(path, "is missing", FINISH)
        film = read_video_track(path)
        if film.pictures != expected:
            raise fault(path, f"has {film.pictures} pictures, its rows in the data set are {expected}", NOT_OF_ONE_TIME)
        _refuse_other_rate(path, film, dataset.fps)
    for episode in dataset.episodes:
        for camera, (begin, end) in episode.spans_s.items():
            pictures = (end - begin) * dataset.fps
            if not abs(pictures - episode.length) < 1.0:
                what = (
                    f"its pictures of {camera} run from {begin:.6g} to {end:.6g} s, {pictures:.0f} at {dataset.fps:g} Hz, "
                    f"its rows are {episode.length}"
                )
                raise fault(dataset.folder / EPISODES, what, NOT_OF_ONE_TIME, episode=episode.index)


def _refuse_other_rate(path: Path, film: Film, fps: float) -> None:
    """Refuse a video that runs faster or slower than its rows, by more than its file rounds."""
    rows_s = film.pictures / fps
    if film.seconds and abs(film.seconds - rows_s) > max(SLACK_PICTURES / fps, SLACK_SHARE * rows_s):
        what = f"runs for {film.seconds:.6g} s, its {film.pictures} rows at {fps:g} Hz for {rows_s:.6g} s"
        raise fault(path, what, NOT_OF_ONE_TIME)


def _row_count_by_file(parts: Iterable[tuple[str, int]]) -> dict[str, int]:
    rows: dict[str, int] = {}
    for file, length in parts:
        rows[file] = rows.get(file, 0) + length
    return rows


def _info(folder: Path) -> dict[str, Any]:
    path = folder / INFO
    try:
        info = json.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise fault(folder, f"has no {INFO}", FOLDER) from error
    except ValueError as error:
        raise fault(path, f"is not JSON ({error})", FINISH) from error
    missing = [name for name in ("codebase_version", "fps", "features", "data_path") if not info.get(name)]
    if missing:
        raise fault(path, f"does not say {', '.join(missing)}", FINISH)
    return dict(info)


def _names(column: Any) -> tuple[str, ...]:
    """Joints of the numbers of a column; none where the file does not name them."""
    names = column.get("names") if isinstance(column, dict) else None
    if isinstance(names, dict):
        names = next((names[key] for key in NAMES_OF_LISTS if key in names), None)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return ()
    return tuple(name.removesuffix(".pos") for name in names)


def _episodes_v21(folder: Path, info: Mapping[str, Any]) -> Iterator[Episode]:
    path = folder / EPISODES_JSONL
    if not path.is_file():
        raise fault(path, "is missing", FINISH)
    size = int(info.get("chunks_size") or 1000)
    with path.open(encoding="utf-8") as lines:
        for number, line in enumerate(lines, 1):
            try:
                entry = json.loads(line)
                index, length = int(entry["episode_index"]), int(entry["length"])
            except (ValueError, KeyError, TypeError) as error:
                raise fault(path, "is not an episode", FINISH, line=number) from error
            place = {"episode_chunk": index // size, "episode_index": index}
            yield Episode(
                index,
                length,
                _fill_path_template(folder, info, "data_path", place),
                _videos(folder, info, lambda _, p=place: p),
            )


def _episodes_v30(folder: Path, info: Mapping[str, Any]) -> Iterator[Episode]:
    files = sorted((folder / EPISODES).rglob("*.parquet"))
    if not files:
        raise fault(folder / EPISODES, "holds no episodes", FINISH)
    for file in files:
        table = parquet_file(file)
        wanted = [name for name in table.schema_arrow.names if not name.startswith("stats/")]
        for row in _rows(file, table.read(columns=wanted)):
            place = {"chunk_index": row["data/chunk_index"], "file_index": row["data/file_index"]}

            def of_video(key: str, row: dict[str, Any] = row) -> dict[str, int]:
                return {name: row[f"videos/{key}/{name}"] for name in ("chunk_index", "file_index")}

            data = _fill_path_template(folder, info, "data_path", place)
            videos = _videos(folder, info, of_video)
            spans = {camera: _span(row, camera) for camera in videos if f"videos/{camera}/to_timestamp" in row}
            yield Episode(int(row["episode_index"]), int(row["length"]), data, videos, spans)


def _span(row: Mapping[str, Any], camera: str) -> tuple[float, float]:
    begin, end = (row.get(f"videos/{camera}/{name}_timestamp") for name in ("from", "to"))
    return float(begin or 0.0), math.nan if end is None else float(end)


def _rows(file: Path, table: pa.Table) -> list[dict[str, Any]]:
    missing = [
        n for n in ("episode_index", "length", "data/chunk_index", "data/file_index") if n not in table.column_names
    ]
    if missing:
        raise fault(file, f"has no column {missing[0]!r}", FINISH)
    rows: list[dict[str, Any]] = table.to_pylist()
    return sorted(rows, key=lambda row: int(row["episode_index"]))


def _videos(folder: Path, info: Mapping[str, Any], place_of: Any) -> dict[str, str]:
    features = info["features"]
    cameras = [key for key, of in features.items() if isinstance(of, dict) and of.get("dtype") == "video"]
    return {key: _fill_path_template(folder, info, "video_path", place_of(key) | {"video_key": key}) for key in cameras}


def _fill_path_template(folder: Path, info: Mapping[str, Any], template: str, place: Mapping[str, Any]) -> str:
    text = info.get(template)
    try:
        return str(text).format(**place)
    except (KeyError, IndexError, ValueError) as error:
        raise fault(folder / INFO, f"its {template} {text!r} cannot be filled in ({error})", FINISH) from error


def _refuse_missing(folder: Path, info: Mapping[str, Any], episodes: Sequence[Episode]) -> None:
    for said, found in (("total_episodes", len(episodes)), ("total_frames", sum(e.length for e in episodes))):
        if info.get(said) is not None and int(info[said]) != found:
            raise fault(folder / INFO, f"says {said} {info[said]}, its episodes are {found}", FINISH)
    if not episodes:
        raise fault(folder / INFO, "has no episodes", FINISH)
    numbers = [episode.index for episode in episodes]
    if numbers != list(range(len(numbers))):
        raise fault(folder / INFO, f"its episodes are {numbers[:5]} ..., not 0, 1, 2 ...", FINISH)
