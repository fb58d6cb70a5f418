"""The report: the result as plain data, and one self-contained HTML page made from it."""

from __future__ import annotations

from typing import Any

from odescope.export.text import to_text
from odescope.identification import Identification

SHOWN = 12  # candidates a target

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{{ title }}</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; color: #1a1a1a }
h1, h2 { line-height: 1.2 } h2 { margin-top: 2.5rem }
pre { background: #f3f4f6; padding: 1rem; overflow-x: auto; white-space: pre-wrap; overflow-wrap: anywhere }
.scroll { overflow-x: auto } table { border-collapse: collapse; font-size: .9rem }
th, td { text-align: left; padding: .3rem .8rem; border-bottom: 1px solid #d4d4d8; vertical-align: top }
td.n { text-align: right; font-variant-numeric: tabular-nums } tr.chosen { background: #fef3c7 }
@media print { h2 { break-after: avoid } pre, tr { break-inside: avoid } }
</style></head><body>
<h1>{{ title }}</h1>
<pre>{{ equations }}</pre>
<ul>
{% for line in trust %}<li>{{ line }}</li>
{% endfor %}</ul>
<h2>What was measured</h2>
<div class="scroll"><table><tr><th>coordinate</th><th>unit</th><th>noise (standard deviation)</th>
<th>cutoff (Hz)</th></tr>
{% for c in channels %}<tr><td>{{ c.name }}</td><td>{{ c.unit }}</td><td class="n">{{ c.noise }}</td>
<td class="n">{{ c.cutoff }}</td></tr>
{% endfor %}</table></div>
{% for s in searches %}
<h2>Candidates for {{ s.target }}</h2>
<p>{{ s.terms }} candidate terms, {{ s.found }} distinct relations, {{ s.kept }} kept.
{% for reason in s.discarded %}{{ reason }}{{ "; " if not loop.last else "." }}{% endfor %}</p>
<div class="scroll"><table><tr><th>relation between</th><th>terms</th><th>guesses</th><th>held-out RMSE</th>
<th>criterion</th></tr>
{% for c in s.candidates %}<tr{% if c.chosen %} class="chosen"{% endif %}><td>{{ c.support }}</td>
<td class="n">{{ c.count }}</td><td class="n">{{ c.consensus }}</td><td class="n">{{ c.rmse }}</td>
<td class="n">{{ c.criterion }}</td></tr>
{% endfor %}</table></div>
{% endfor %}
<h2>The study as resolved</h2>
<pre>{{ study }}</pre>
</body></html>
"""


def summary(result: Identification, title: str, study: str) -> dict[str, Any]:
    """Return the result as plain data that serialises to JSON."""
    free_run: Any = result.model.scores["free_run"]
    trust = [f"{c.target}: predicts {c.target_r2:.2%} of its variance on held-out data (R²)" for c in result.chosen]
    trust.append(
        f"free run over {free_run['duration']:.4g} s of the record: valid for {free_run['valid_time']:.4g} s"
        + (f"; {free_run['ended']}" if free_run["ended"] else "")
    )
    trust += result.notes
    units = {c.name: c.unit or "" for c in result.model.coordinates}
    return {
        "title": title,
        "equations": to_text(result.model, 6),
        "trust": trust,
        "channels": [
            {"name": c.name, "unit": units[c.name], "noise": f"{c.noise:.4g}", "cutoff": f"{c.cutoff:.4g}"}
            for c in result.signals.channels
        ],
        "searches": [
            {
                "target": s.problem.target,
                "terms": len(s.problem.terms),
                "found": len(s.found.supports),
                "kept": len(s.ranked.candidates),
                "discarded": [f"{count} {reason}" for reason, count in s.ranked.discarded],
                "candidates": [
                    {
                        "support": " + ".join(s.problem.terms[j].text for j in c.support),
                        "count": len(c.support),
                        "consensus": len(c.guesses),
                        "rmse": f"{c.target_rmse:.4g}",
                        "criterion": f"{c.criterion:.1f}",
                        "chosen": c is chosen,
                    }
                    for c in s.ranked.candidates[:SHOWN]
                ],
            }
            for s, chosen in zip(result.searches, result.chosen, strict=True)
        ],
        "study": study,
    }


def to_html(data: dict[str, Any]) -> str:
    """Return the page; every text in it is escaped."""
    from jinja2 import Environment

    return Environment(autoescape=True, trim_blocks=True).from_string(_PAGE).render(**data)
