"""The templates of pages: one place that loads them."""

from __future__ import annotations

from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

__all__ = ["rendered"]


def rendered(template: str, **content: Any) -> str:
    """Fill a template of this package; what it holds is escaped.

    Parameters
    ----------
    template : str
        File name in ``templates/``.
    **content
        What it asks for; a name that is missing is an error.
    """
    environment = Environment(
        loader=PackageLoader("pv_inspect"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**content)
