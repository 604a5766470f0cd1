"""What is known about the module, and the review as a table and a report."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from napari.qt.threading import create_worker
from qtpy.QtCore import QUrl
from qtpy.QtGui import QDesktopServices
from qtpy.QtWidgets import (
    QFormLayout,
    QGroupBox,
    QHBoxLayout,
    QLineEdit,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from napari_pv_inspect.models.workbench import WorkbenchModel
from napari_pv_inspect.review.model import ReviewModel
from napari_pv_inspect.tasks.guard import attempt
from napari_pv_inspect.widgets.listen import listen
from pv_inspect.errors import InspectionError
from pv_inspect.results.read import read_result
from pv_inspect.review import ModuleData, ReviewStore
from pv_inspect.review.report import REVIEW_PAGE, VERDICTS_TABLE, export_review

__all__ = ["ExportBox"]

FIELDS = {
    "serial_number": ("Serial number", "As on the label of the module."),
    "current_a": ("Current, A", "Current while the frames were taken, ampere."),
    "exposure_s": ("Exposure, s", "Exposure time of one frame, seconds."),
    "temperature_c": ("Temperature, \N{DEGREE SIGN}C", "Temperature of the module, Celsius."),
}


class ExportBox(QGroupBox):
    """Module data of the report, and the buttons that write it."""

    def __init__(
        self, model: WorkbenchModel, review: ReviewModel, parent: QWidget | None = None
    ) -> None:
        super().__init__("Report", parent)
        self._model, self._review = model, review
        form = QFormLayout()
        form.setVerticalSpacing(1)
        self.fields: dict[str, QLineEdit] = {}
        for name, (label, tip) in FIELDS.items():
            field = QLineEdit()
            field.setToolTip(f"{tip} Empty: not known; the report has a line to fill in by hand.")
            field.editingFinished.connect(self._on_edited)
            form.addRow(label, field)
            self.fields[name] = field
        self.export = QPushButton("Write table and report")
        self.export.setToolTip(
            f"Write {VERDICTS_TABLE} and {REVIEW_PAGE}, which prints well, into the result folder."
        )
        self.open = QPushButton("Show report")
        self.open.setToolTip("Open the report in the web browser.")
        buttons = QHBoxLayout()
        buttons.addWidget(self.export)
        buttons.addWidget(self.open)
        layout = QVBoxLayout(self)
        layout.addLayout(form)
        layout.addLayout(buttons)
        self.export.clicked.connect(self._on_export)
        self.open.clicked.connect(self._on_open)
        listen(review.storage.module_data_changed, self._show)
        listen(review.data.subject_changed, self._on_subject)
        listen(review.storage.flush_wanted, self._flush)
        self._on_subject()

    def _on_subject(self, _: object = None) -> None:
        self.setEnabled(self._review.data.subject is not None)
        self._show(self._review.storage.module_data)

    def _show(self, data: ModuleData) -> None:
        for name, field in self.fields.items():
            value = getattr(data, name)
            field.setText(
                value if isinstance(value, str) else "" if value is None else f"{value:g}"
            )

    def _flush(self) -> None:
        if any(field.isModified() for field in self.fields.values()):
            self._on_edited()

    def _on_edited(self) -> None:
        if self._review.data.subject is None:
            return
        try:
            data = ModuleData(
                self.fields["serial_number"].text().strip(),
                *(self._number(name) for name in FIELDS if name != "serial_number"),
            )
        except InspectionError as error:
            self._model.notice(str(error), is_error=True)
            self._show(self._review.storage.module_data)
            return
        self._review.storage.describe(data)

    def _number(self, name: str) -> float | None:
        text = self.fields[name].text().strip().replace(",", ".")
        if not text:
            return None
        try:
            return float(text)
        except ValueError:
            raise InspectionError(
                f"{FIELDS[name][0]} is {text!r}: give a number, or nothing if it is not known."
            ) from None

    def _on_export(self) -> None:
        self._review.storage.after_storing(self._write)

    def _write(self) -> None:
        folder = self._review.storage.folder
        if folder is None:
            return
        worker = create_worker(_export, folder)
        worker.returned.connect(self._on_written)
        worker.start()

    def _on_written(self, answer: tuple[str, bool]) -> None:
        self._model.notice(answer[0], answer[1])

    def _on_open(self) -> None:
        folder = self._review.storage.folder
        page = None if folder is None else folder / REVIEW_PAGE
        if page is None or not page.is_file():
            self._model.notice("There is no report yet: write it first.")
            return
        QDesktopServices.openUrl(QUrl.fromLocalFile(str(page)))


def _export(folder: Path) -> tuple[str, bool]:
    """Write both files; returns a sentence and whether it says that they could not be written."""
    said = attempt(partial(_write_both, folder), "The report was not written")
    return str(said), isinstance(said, InspectionError)


def _write_both(folder: Path) -> str:
    with ReviewStore(folder) as store:
        table, page = export_review(read_result(folder), store)
    return f"Wrote {table.name} and {page.name} into {folder}."
