from .column_map import BARE_PATTERN as BARE_PATTERN
