"""The style sheet of the report: readable on a phone, in a light and in a dark room."""

STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --soft: #5b6570; --paper: #ffffff;
  --panel: #f3f5f7; --line: #c9d0d7; --good: #007a56; --bad: #b3400a; --mark: #0a5fa8;
  --heat: #b3400a; --red: #c22b2b; --green: #1a7f37; --blue: #2259c7; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ec; --soft: #9aa5b1;
  --paper: #14181c; --panel: #1f252b; --line: #3b454f; --good: #3ecf9b; --bad: #ff9a5c;
  --mark: #6db7ff; --heat: #ff9a5c; --red: #ff7b72; --green: #56d364; --blue: #79a8ff; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 46rem; padding: 1rem; background: var(--paper);
  color: var(--ink); font: 1rem/1.5 system-ui, sans-serif; overflow-wrap: anywhere; }
h1 { font-size: 1.6rem; line-height: 1.2; } h2 { font-size: 1.2rem; margin: 2rem 0 0.5rem; }
p { margin: 0.5rem 0; } .soft { color: var(--soft); font-size: 0.9rem; }
.good { color: var(--good); } .bad { color: var(--bad); }
ul { margin: 0.5rem 0; padding-left: 1.3rem; } li { margin: 0.25rem 0; }
.wide { overflow-x: auto; } table { border-collapse: collapse; min-width: 100%; }
th, td { text-align: left; padding: 0.25rem 0.75rem 0.25rem 0; vertical-align: top;
  border-bottom: 1px solid var(--line); font-variant-numeric: tabular-nums; }
th, td { overflow-wrap: normal; } th { font-weight: 600; }
svg { display: block; width: 100%; height: auto; margin: 0.5rem 0; background: var(--panel);
  border-radius: 0.4rem; }
figure { margin: 0; } figcaption { font-size: 0.9rem; }
.photos { display: grid; gap: 1rem; grid-template-columns: repeat(auto-fill, minmax(11rem, 1fr)); }
.photos img, .blank { display: block; width: 100%; border-radius: 0.4rem; }
.blank { background: var(--panel); color: var(--soft); padding: 2rem 1rem; text-align: center; }
.cell { fill: none; stroke: var(--line); } .empty { fill: var(--bad); fill-opacity: 0.18;
  stroke: var(--bad); } .dot { fill: var(--mark); }
.count { font-size: 18px; fill: var(--ink); paint-order: stroke; stroke: var(--paper);
  stroke-width: 3px; stroke-opacity: 0.7; } .middle { text-anchor: middle; }
.frame { fill: none; stroke: var(--line); } .guide { stroke: var(--line); stroke-dasharray: 4 4; }
.arrow { stroke: var(--soft); stroke-opacity: 0.5; } .arrow.mean { stroke: var(--bad);
  stroke-opacity: 1; stroke-width: 2.5px; } .foot { fill: var(--bad); }
.heat { fill: var(--heat); } .unknown { fill: var(--line); }
.curve { fill: none; stroke-width: 2px; } .band { fill-opacity: 0.2; stroke: none; }
.curve.r { stroke: var(--red); } .curve.g { stroke: var(--green); }
.curve.b { stroke: var(--blue); } .band.r { fill: var(--red); } .band.g { fill: var(--green); }
.band.b { fill: var(--blue); }
@media print { body { max-width: none; } h2 { break-after: avoid; } }
"""
