"""The page of a survey: one HTML file with all pictures in it, that needs no network and no script."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from ..files.html_pages import PAGE_STYLE, html_page, join_lines, picture_element
from ..solve.confidence.words import confidence_in_words
from .drawn_people import DrawnPerson
from .histograms import Histogram, round_up
from .reading import PeopleFiles
from .survey import SCORES, Kinds, PersonScore, Survey

_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 420, 202, 24, 34, 32  # [px] of a histogram, and its margins
_MOST_LISTED = 40  # kinds of errors or warnings
_STYLE = """
.tiles{display:grid;grid-template-columns:repeat(auto-fill,minmax(155px,1fr));gap:10px;margin:16px 0}
.tile{background:var(--panel);border-radius:6px;padding:9px 12px}.tile b{display:block;font-size:21px}
.plots{display:grid;grid-template-columns:repeat(auto-fill,minmax(410px,1fr));gap:18px}
svg{width:100%;height:auto;display:block}svg text{fill:var(--soft)}svg .title{fill:var(--ink)}svg rect{fill:var(--bar)}
svg path{stroke:var(--soft)}svg .middle{stroke:var(--accent)}svg .beyond{fill:var(--accent)}
.people{display:grid;grid-template-columns:repeat(auto-fill,minmax(270px,1fr));gap:16px}
.people img{width:100%;height:230px;object-fit:contain;background:#ebebeb;border-radius:4px}
.people figcaption b{color:var(--ink)}
"""


def write_page(files: PeopleFiles, survey: Survey, people: Sequence[DrawnPerson], *, note: str) -> str:
    """The page as text; ``note`` says what the people are drawn over."""
    title = f"Data set {files.folder.resolve().name}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<p class=soft>{len(files.paths)} of {files.expected} shards; rows are named shard/row, both from 0 on.</p>",
        _tiles(survey),
        _marks(files, survey),
        "<h2>Distributions</h2><p class=soft>Of people with a body; dashed: the median.</p><div class=plots>",
        *(_figure(score, survey.distributions.get(score.name)) for score in SCORES),
        "</div>",
        _kinds("Errors: rows without a body", survey.errors, survey.rows),
        _kinds("Warnings: rows may have several", survey.warnings, survey.rows),
        _people(files, survey, people, note),
        _provenance(survey.made),
    ]
    return html_page(title, PAGE_STYLE + _STYLE, join_lines(parts))


def _share(count: int, total: int) -> str:
    """A share in percent, exact at both ends."""
    if count in (0, total):
        return "100 %" if total and count else "0 %"
    digits = 2 if not 1 <= 100 * count / total <= 99 else 0
    percent = f"{100 * count / total:.{digits}f}"
    return f"{'under 0.01' if percent == '0.00' else 'over 99.99' if percent == '100.00' else percent} %"


def _time(seconds: float) -> str:
    size, unit = next((each for each in ((3600, "h"), (60, "min")) if seconds >= each[0]), (1, "s"))
    return f"{seconds / size:.1f} {unit}"


def _tiles(survey: Survey) -> str:
    tiles = [
        ("pictures", f"{survey.pictures:,}", f"{_share(survey.nobody, survey.pictures)} show nobody"),
        ("rows", f"{survey.rows:,}", f"{survey.people:,} of people"),
        ("bodies", f"{survey.bodies:,}", f"{_share(survey.bodies, survey.people)} of the people"),
        ("rows with an error", f"{survey.rows_at_fault:,}", f"{_share(survey.rows_at_fault, survey.rows)} of all"),
        ("rows with a warning", f"{survey.warned:,}", f"{_share(survey.warned, survey.bodies)} of the bodies"),
    ]
    if survey.rate is not None:
        tiles.append(("bodies a second", f"{survey.rate:.3g}", f"of one process; {_time(survey.seconds)} of all"))
    return f"<div class=tiles>{''.join(f'<div class=tile>{n}<b>{v}</b>{escape(t)}</div>' for n, v, t in tiles)}</div>"


def _marks(files: PeopleFiles, survey: Survey) -> str:
    """Sentences about what makes a data set doubtful as a whole."""
    marks = []
    if missing := files.expected - len(files.paths):
        absent = [str(shard) for shard in range(files.expected) if shard not in files.paths][:10]
        more = ", ..." if missing > len(absent) else ""
        marks.append(f"{missing} of {files.expected} shards are not there: {', '.join(absent)}{more}")
    marks += [f"{first}: {count} so, first shard {where.shard}" for count, first, where in survey.faults.sorted()]
    marks += [f"Not the same in all shards: {name}" for name in survey.differing]
    return "".join(f"<p class=mark>{escape(each)}</p>" for each in marks)


def _figure(score: PersonScore, histogram: Histogram | None) -> str:
    if histogram is None or not histogram.total:
        return ""
    shares = (0.01, 0.05) if score.worst == "low" else (0.95, 0.99)
    below = ", ".join(f"{100 * share:.0f} % below {histogram.quantile(share):.3g}" for share in shares)
    extent = f"{histogram.low:.3g} to {histogram.high:.3g} {score.unit}".rstrip()
    caption = f"{extent}; median {histogram.quantile(0.5):.3g}; {below}; {histogram.total:,} people"
    return f"<figure>{_histogram(score, histogram)}<figcaption>{escape(caption)}</figcaption></figure>"


def _histogram(score: PersonScore, histogram: Histogram) -> str:
    """Bars as SVG, with the median, and how many lie beyond."""
    bars = histogram.bars()
    width, height = _WIDTH - 2 * _LEFT, _HEIGHT - _BOTTOM - _TOP
    extent, most = bars.stop - bars.start, max(int(bars.counts.max()), 1)

    def across(value: float) -> float:
        return _LEFT + width * (value - bars.start) / extent

    bottom, wide = _TOP + height, max(width / len(bars.counts) - 1, 1)
    drawn = []
    for index, count in enumerate(bars.counts.tolist()):
        if count:
            low, tall = bars.start + index * bars.step, max(height * count / most, 0.7)
            text = f"{low:.4g} to {low + bars.step:.4g} {score.unit}: {count:,}"
            attributes = f"x='{across(low):.1f}' y='{bottom - tall:.1f}' width='{wide:.1f}' height='{tall:.1f}'"
            drawn.append(f"<rect {attributes}><title>{escape(text)}</title></rect>")
    step = round_up(extent / 7)
    ticks = np.arange(np.ceil(bars.start / step - 1e-6), np.floor(bars.stop / step + 1e-6) + 1) * step + 0.0
    for tick in ticks.tolist():
        x = across(tick)
        drawn.append(f"<path d='M{x:.1f} {bottom}v4'/>")
        drawn.append(f"<text x='{x:.1f}' y='{bottom + 16}' text-anchor='middle'>{_plain(tick, step)}</text>")
    middle = histogram.quantile(0.5)
    x = min(max(across(middle), _LEFT), _WIDTH - _LEFT)
    drawn.append(f"<path d='M{x:.1f} {_TOP}V{bottom}' class='middle' stroke-dasharray='4 3'/>")
    for beyond, side, anchor, edge in (
        (bars.below, "below", "start", _LEFT),
        (bars.above, "beyond", "end", _WIDTH - _LEFT),
    ):
        if beyond:
            text = f"{beyond:,} {side}"
            drawn.append(f"<text x='{edge}' y='{_HEIGHT - 3}' text-anchor='{anchor}' class='beyond'>{text}</text>")
    name = score.title + (f" [{score.unit}]" if score.unit else "")
    return (
        f"<svg viewBox='0 0 {_WIDTH} {_HEIGHT}' role='img' font-size='11'>"
        f"<text x='{_LEFT}' y='13' font-size='13' font-weight='600' class='title'>{escape(name)}</text>"
        f"<path d='M{_LEFT} {bottom}H{_WIDTH - _LEFT}'/>{''.join(drawn)}"
        f"<text x='{_WIDTH - _LEFT}' y='{_TOP - 4}' text-anchor='end'>highest: {most:,}</text></svg>"
    )


def _plain(value: float, step: float) -> str:
    """A tick's number, with as many digits as steps need."""
    digits = max(0, -int(np.floor(np.log10(step) + 1e-9)))
    return f"{value:.{digits}f}" if digits < 6 else f"{value:.3g}"


def _kinds(title: str, kinds: Kinds, rows: int) -> str:
    """Errors or warnings as a table."""
    listed = kinds.sorted()
    if not listed:
        return f"<h2>{title}</h2><p>None.</p>"
    lines = [
        f"<tr><td class=n>{count:,}<td class=n>{_share(count, rows)}<td>{escape(first)}<td><code>{where}</code></tr>"
        for count, first, where in listed[:_MOST_LISTED]
    ]
    left = sum(each[0] for each in listed[_MOST_LISTED:]) + kinds.others
    more = f"<p class=soft>And {left:,} of rarer kinds.</p>" if left else ""
    head = "<tr><th class=n>count<th class=n>of rows<th>the first of this kind<th>at row</tr>"
    return f"<h2>{title}</h2><table>{head}{''.join(lines)}</table>{more}"


def _provenance(made: Mapping[str, Kinds]) -> str:
    lines = []
    for name, kinds in made.items():
        values = kinds.sorted()
        text = "; ".join(
            escape(value) + (f" ({count:,} shards, first {where.shard})" if len(values) > 1 else "")
            for count, value, where in values[:8]
        )
        lines.append(f"<tr{' class=mark' if len(values) > 1 else ''}><td>{escape(name)}<td>{text}</tr>")
    text = "The same in all shards, but for what is marked."
    return f"<h2>Made with</h2><p class=soft>{text}</p><table>{''.join(lines)}</table>"


def _people(files: PeopleFiles, survey: Survey, people: Sequence[DrawnPerson], note: str) -> str:
    score = survey.worst.score
    end = "largest" if score.worst == "high" else "smallest"
    command = f"partdr export {files.folder} --rows {people[0].address if people else '0/0'} --to glb --out out"
    cards = []
    for each in people:
        shown = picture_element(each.jpeg, "jpeg", f"row {each.address}")
        sure = "" if each.confidence is None else f"<br>{confidence_in_words(each.confidence)}"
        warned = "".join(f"<br><span class=warn>{escape(warning)}</span>" for warning in each.warnings)
        caption = f"{each.value:.3g} {score.unit}<br>{escape(each.picture)}, person {each.person}{sure}"
        cards.append(f"<figure>{shown}<figcaption><b>{each.address}</b> {caption}{warned}</figcaption></figure>")
    return (
        f"<h2>The worst {len(people)}: {end} &ldquo;{escape(score.title)}&rdquo;</h2><p>{escape(note)} "
        f"A body's files: <code>{escape(command)}</code></p><div class=people>{join_lines(cards)}</div>"
    )
