"""The table of a campaign: a DataFrame whose columns also answer to the names they had."""

import pandas as pd

from rhec.core._casadi.renamed import new_name

__all__ = ["CampaignTable"]


class CampaignTable(pd.DataFrame):
    """Rows of `rhec.campaign`. A column's old name answers, too, with a line that says the new."""

    @property
    def _constructor(self):
        return CampaignTable

    def __getitem__(self, key):
        return super().__getitem__(self._current(key))

    def __getattr__(self, name):
        new = None if name.startswith("_") or name in self.columns else new_name(name, self.columns)
        return super().__getattr__(new or name)

    def groupby(self, by=None, *arguments, **named):
        return super().groupby(self._current(by), *arguments, **named)

    def _current(self, key):
        """The key, or the keys in a list, with the names that columns have now."""
        keys = list(map(self._current_name, key if isinstance(key, list) else [key]))
        return keys if isinstance(key, list) else keys[0]

    def _current_name(self, name):
        if not isinstance(name, str) or name in self.columns:
            return name
        return new_name(name, self.columns, 5) or name
