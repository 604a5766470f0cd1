"""Controls keep their size where there is little room; they fold instead."""

from __future__ import annotations

from pytestqt.qtbot import QtBot
from qtpy.QtWidgets import QPushButton, QVBoxLayout, QWidget

from napari_pv_inspect.widgets.folding_bar import FoldingBar


def test_it_folds_where_there_is_no_room_for_one_row(qtbot: QtBot) -> None:
    first, second = QPushButton("a long first name"), QPushButton("a long second name")
    bar = FoldingBar((first,), (second,))
    room = QWidget()
    QVBoxLayout(room).addWidget(bar)
    qtbot.addWidget(room)
    room.show()
    both = first.sizeHint().width() + second.sizeHint().width()
    for width, folded in ((both + 80, False), (both, True), (both + 80, False)):
        room.resize(width, 100)
        qtbot.waitUntil(lambda folded=folded: bar.is_folded is folded)

        def is_laid_out(folded: bool = folded) -> bool:
            tops = [button.mapTo(bar, button.rect().topLeft()).y() for button in (first, second)]
            return (tops[0] < tops[1]) is folded

        qtbot.waitUntil(is_laid_out)
        assert second.width() >= second.minimumSizeHint().width()


def test_it_may_be_as_narrow_as_its_wider_group(qtbot: QtBot) -> None:
    first, second = QPushButton("a long first name"), QPushButton("short")
    bar = FoldingBar((first,), (second,))
    qtbot.addWidget(bar)
    bar.resize(600, 30)
    bar.show()
    qtbot.waitUntil(lambda: not bar.is_folded)
    assert bar.minimumSizeHint().width() <= first.sizeHint().width()
