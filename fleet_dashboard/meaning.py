"""What a label means, as docs/concepts/guarantees.md says it; a test holds the two against each other."""

from typing import Final, NamedTuple

from fleet_bus.messages import Label


class Meaning(NamedTuple):
    """One row of the table there."""

    get: str
    state: str
    breaks: str
    know: str


MEANINGS: Final = {
    Label.GUARANTEED: Meaning(
        "at each time of the tube, every state that the vehicle can be in lies in the set of that time",
        "bounds of both noises and of slopes, each with origin: given; what the coming inputs keep",
        "a stated bound is false, the vehicle changes, the side information that cut the set is false",
        "one miss suffices: event miss or data_contradicted, label contradicted until nothing that refuted it is left. "
        "A bound that is false but not yet refuted shows in nothing",
    ),
    Label.CALIBRATED: Meaning(
        "at least the profile's confidence of the measured states lie in their set, in the long run",
        "nothing",
        "the errors to come are not like those on record: other driving, other ground, a worn tyre",
        "afterwards: the audit counts, event coverage, label contradicted until the record is in its band again",
    ),
    Label.UNCOVERED: Meaning(
        "nothing; the set was computed with a bound missing, or with a model that rests on data outside of which the "
        "vehicle is now",
        "–",
        "–",
        "the label",
    ),
    Label.CONTRADICTED: Meaning(
        "nothing; what was measured has refuted what the label would have said",
        "–",
        "–",
        "the label, and the event that came with it",
    ),
}
QUESTIONS: Final = ("What you get", "What must be stated", "What breaks it", "How you will know")
