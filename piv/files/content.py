"""Kind of a file by its first bytes, for messages about files whose names promise another kind."""

from pathlib import Path

from ground.plain_file import open_plain

LONGEST_HEAD = 64  # bytes that tell the kind
_RENAME = {
    (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"): (".tif", "TIFF"),
    (b"\x89PNG",): (".png", "PNG"),
    (b"\xff\xd8\xff",): (".jpg", "JPEG"),
    (b"BM",): (".bmp", "BMP"),
    (b"P5",): (".pgm", "PGM"),
}
_OTHER = {
    b"version https://git-lfs": "is a Git LFS pointer and not the frame; get the frame by: git lfs pull",
    b"<": "is a web page or XML and no frame; download the frame again",
    b"GIF8": "is a GIF; convert it to PNG or TIFF",
    b"RIFF": "is a WebP or AVI file; convert it to PNG or TIFF, or rename a video to .avi",
    b"\x1f\x8b": "is compressed by gzip; unpack it by: gunzip",
    b"PK\x03\x04": "is a ZIP archive; unpack it",
}


def other_content(file: Path) -> str:
    """Return what a file is and what to do, if it is of another kind than its name says; else an empty string."""
    try:
        with open_plain(file) as stream:
            head = stream.read(LONGEST_HEAD)
    except OSError:
        return ""
    if not head:
        return "is empty; copy it from the camera again"
    for signs, (ending, kind) in _RENAME.items():
        if head.startswith(signs) and file.suffix.lower().replace("e", "")[:4] != ending:  # .jpeg, .tiff
            return f"is a {kind} by its content; rename it to {file.stem}{ending}"
    return next((what for sign, what in _OTHER.items() if head.lstrip().startswith(sign)), "")
