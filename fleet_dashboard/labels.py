"""What a label means, one click away."""

from nicegui import ui

from fleet_dashboard.meaning import MEANINGS, QUESTIONS
from fleet_dashboard.theme import COLOURS


def meaning_dialog() -> ui.dialog:
    """A dialog that says what each label claims."""
    with ui.dialog() as dialog, ui.card().classes("max-w-3xl gap-2"):
        ui.label("What a label claims").classes("text-lg font-medium")
        ui.label(
            "A label is part of the answer: the same set means different things under different labels. A set is about "
            "the reference point of the vehicle, at the times of its steps; between them it says nothing."
        ).classes("fleet-quiet")
        for label, meaning in MEANINGS.items():
            with ui.row().classes("items-center gap-0 q-pt-sm"):
                ui.element("span").classes("fleet-dot").style(f"background:{COLOURS[label]}")
                ui.label(str(label)).classes("font-medium")
            for question, answer in zip(QUESTIONS, meaning, strict=True):
                if answer != "–":
                    with ui.row().classes("no-wrap gap-2 q-pl-md w-full"):
                        ui.label(question).classes("fleet-quiet w-40 shrink-0")
                        ui.label(answer)
        ui.button("close", on_click=dialog.close).props("flat").classes("self-end")
    return dialog
