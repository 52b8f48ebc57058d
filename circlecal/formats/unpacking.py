"""ZIPs of pictures and annotations in the place of folders of them: unpacked into the folder of a run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path, PurePosixPath

from circlecal.errors import InputError
from circlecal.files import is_file
from circlecal.formats.annotation import require_annotations
from circlecal.formats.paint_list import LIST_NAME
from circlecal.formats.registry import annotation_suffixes
from circlecal.names import as_stem
from circlecal.pictures.archives import SUFFIX, unpack
from circlecal.pictures.files import PICTURE_SUFFIXES, distinct_names, walk
from circlecal.pictures.inputs import VIDEO_SUFFIXES

UNPACKED_FOLDER = "unpacked"
"""In the folder of a run: a folder for each archive that was given, named like it."""
FRAME_SUFFIXES = frozenset({*PICTURE_SUFFIXES, *VIDEO_SUFFIXES})
_ANNOTATION_SUFFIX = ".json"
"""Of the workbench's annotations."""


def is_archive(path: Path) -> bool:
    """Whether something that was named is a ZIP, by its suffix."""
    return path.suffix.lower() == SUFFIX and is_file(path)


def may_be_annotation(path: PurePosixPath) -> bool:
    """Whether a file of an archive is looked at, by its name: annotations, and the list beside them."""
    return path.suffix.lower() in annotation_suffixes() or path.name == LIST_NAME


def places_of(archives: Sequence[Path], folder: Path) -> list[Path]:
    """A folder for each archive below ``folder``, named like it and unlike those of the others."""
    return [folder / name for name in distinct_names([as_stem(path.stem) for path in archives])]


def require_frames_in(given: object, *, is_any: bool) -> None:
    """See that something of an archive can be used.

    Raises
    ------
    InputError
        Nothing can.
    """
    if not is_any:
        raise InputError(f"{given}: holds no picture, no video and no annotation; give a ZIP of one of these")


def tell_others(given: object, others: Sequence[PurePosixPath], tell: Callable[[str], None]) -> None:
    """Say how many files of an archive are left out, if any."""
    if others:
        tell(f"{given}: {len(others)} files in it are neither pictures nor annotations, and are left out")


def unpack_archives(archives: Sequence[Path], out: Path, tell: Callable[[str], None]) -> list[Path]:
    """The folders of pictures, videos and annotations into which archives were unpacked, each one's own in ``out``; a
    file that is there already is not written again, and one that the archive no longer holds is taken away.

    Parameters
    ----------
    archives : sequence of path
        ZIPs.
    out : path
        Folder of the run.
    tell : callable
        Called with what is left out of an archive.

    Raises
    ------
    InputError
        An archive is damaged, encrypted, too large, or holds neither pictures nor videos nor annotations.
    """
    places = places_of(archives, out / UNPACKED_FOLDER)
    for given, place in zip(archives, places, strict=True):

        def folder_of(path: PurePosixPath, place: Path = place) -> Path | None:
            return place if path.suffix.lower() in FRAME_SUFFIXES or may_be_annotation(path) else None

        unpacked = unpack(given, str(given), folder_of)
        require_frames_in(given, is_any=bool(unpacked.files))
        for warning in unpacked.warnings(str(given)):
            tell(warning)
        tell_others(given, unpacked.others, tell)
        _keep_only(place, unpacked.files)
    return places


def annotations_in(given: Path | None, out: Path) -> Path | None:
    """The folder of annotations of the workbench that was named; of a ZIP of one, the folder in ``out`` into which it
    was unpacked. None where nothing was named.

    Raises
    ------
    InputError
        There is no such folder, or the archive is damaged, encrypted, too large, empty, or holds several folders.
    """
    if given is None:
        return None
    if not is_archive(given):
        require_annotations(given)
        return given
    place = out / UNPACKED_FOLDER / f"{as_stem(given.stem)}.annotations"
    unpacked = unpack(given, str(given), lambda path: place if path.suffix.lower() == _ANNOTATION_SUFFIX else None)
    if not unpacked.files:
        raise InputError(f"{given}: holds no file of annotations; circlecal annotate writes a folder of them")
    _keep_only(place, unpacked.files)
    folders = sorted({path.parent for path in unpacked.files})
    if len(folders) > 1:
        told = " and ".join(str(folder.relative_to(place)) for folder in folders[:2])
        raise InputError(f"{given}: holds annotations in {len(folders)} folders ({told}); give a ZIP of one of them")
    return folders[0]


def _keep_only(place: Path, files: Iterable[Path]) -> None:
    """Take away what an earlier archive of that name left."""
    kept = set(files)
    for path in [path for path in walk(place) if path not in kept]:
        path.unlink()
