from .drafts import draft as draft
from .inspection import inspect as inspect
from .refused import otherwise_separated as otherwise_separated
from .refused import refusals as refusals
from .summaries import in_shown_unit as in_shown_unit
from .summaries import numeric_columns as numeric_columns
from .summaries import summary as summary
from .unusual import why_unusual as why_unusual
