"""What can be wrong with an image file, in words that follow its name."""

from __future__ import annotations

__all__ = ["ImageFileError", "damaged", "needs_decoder", "needs_package", "unreadable"]

_COPY_AGAIN = "copy it again from the camera or remove it."


class ImageFileError(Exception):
    """An image file can't be used; the text goes on after the file's name and ends a sentence.

    Parameters
    ----------
    text : str
    reason : str, optional
        What is wrong with it as a clause, without what to do.
    """

    def __init__(self, text: str, reason: str | None = None) -> None:
        super().__init__(text)
        self.reason = reason or f"it {text.partition(':')[0]}"


def damaged(reason: str) -> ImageFileError:
    """The content is not what the format demands."""
    return ImageFileError(f"can't be read ({reason}): {_COPY_AGAIN}", reason)


def needs_decoder(what: str) -> ImageFileError:
    """The file may well be whole, but nothing here reads its kind."""
    return ImageFileError(
        f"is stored as {what}, which needs a decoder that is not installed: convert it without "
        "loss to an uncompressed or Deflate TIFF or a PNG of 8 or 16 bits."
    )


def needs_package(what: str, extra: str) -> ImageFileError:
    """The file may well be whole, but an optional package is missing that reads its kind."""
    return ImageFileError(
        f"is {what}, which needs a decoder that is not installed: "
        f"pip install 'pv-inspect[{extra}]', or convert it to TIFF."
    )


def unreadable(error: OSError) -> ImageFileError:
    """The system does not give the file's content."""
    if isinstance(error, FileNotFoundError):
        return ImageFileError("is no longer there: put it back, or open the frames again.")
    if isinstance(error, PermissionError):
        return ImageFileError(f"can't be read ({error.strerror}): check its permissions.")
    return damaged(error.strerror or type(error).__name__)
