"""The HTML report's looks: one style sheet, light, dark and printed."""

from __future__ import annotations

STYLESHEET = """\
:root {
  color-scheme: light dark;
  --page: #ffffff; --raised: #f6f7f9; --line: #d9dde2; --frame: #e3e6ea;
  --ink: #1f2328; --quiet: #57606a; --link: #0a58a8;
  --agree: #0b5a47; --agree-back: #e2f3ed;
  --differ: #93370d; --differ-back: #fdece0;
  --unsure: #4a5159; --unsure-back: #eceef1;
}
@media screen and (prefers-color-scheme: dark) {
  :root {
    --page: #15181c; --raised: #1e2227; --line: #363c44; --frame: #363c44;
    --ink: #e4e7eb; --quiet: #a4adb8; --link: #82baff;
    --agree: #7fdcbd; --agree-back: #12332a;
    --differ: #ffb48a; --differ-back: #40230f;
    --unsure: #c3cad3; --unsure-back: #2b3037;
  }
}
*, ::before, ::after { box-sizing: border-box; }
html { scroll-padding-top: 1.5rem; text-size-adjust: 100%; -webkit-text-size-adjust: 100%; }
body {
  margin: 0 auto; padding: 0 clamp(1rem, 3vw, 2.5rem) 5rem; max-width: 86rem;
  background: var(--page); color: var(--ink); overflow-wrap: break-word;
  font: 1.0625rem/1.62 system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "Liberation Sans",
    sans-serif;
}
a { color: var(--link); text-decoration-thickness: 1px; text-underline-offset: 0.18em; }
a:hover { text-decoration-thickness: 2px; }
:focus-visible { outline: 3px solid var(--link); outline-offset: 3px; border-radius: 2px; }
.skip { position: absolute; left: -100rem; }
.skip:focus { left: 1rem; top: 0.5rem; padding: 0.4rem 0.8rem; background: var(--page); z-index: 2; }

body > header { padding: clamp(1.8rem, 5vw, 3.6rem) 0 1.8rem; border-bottom: 1px solid var(--line); }
h1 { margin: 0; max-width: 26em; font-size: clamp(1.7rem, 1.2rem + 2vw, 2.6rem); line-height: 1.18;
  font-weight: 650; letter-spacing: -0.015em; text-wrap: balance; }
.subtitle { margin: 0.8rem 0 0; max-width: 46rem; color: var(--quiet); }
h2, h3, h4 { line-height: 1.28; font-weight: 650; text-wrap: balance; }
h2 { margin: 3.4rem 0 1rem; font-size: 1.55rem; letter-spacing: -0.01em; }
h3 { margin: 2.6rem 0 0.8rem; font-size: 1.22rem; }
h4 { margin: 2rem 0 0.6rem; font-size: 1.05rem; }
section:first-child > h2 { margin-top: 2rem; }
main p, main ul { max-width: 44rem; margin: 0.9rem 0; }
main ul { padding-left: 1.3rem; }
li + li { margin-top: 0.3rem; }
code, pre { font-family: ui-monospace, SFMono-Regular, Menlo, Consolas, "Liberation Mono", monospace; }
code { padding: 0.1em 0.3em; border-radius: 4px; background: var(--raised); font-size: 0.9em; }
pre { margin: 1.2rem 0; padding: 0.9rem 1.1rem; overflow-x: auto; border: 1px solid var(--line);
  border-radius: 8px; background: var(--raised); font-size: 0.88rem; line-height: 1.5; tab-size: 4; }

nav ol { margin: 0; padding: 0; list-style: none; font-size: 0.92rem; line-height: 1.4; }
nav li { margin: 0; }
nav li + li { margin-top: 0.1rem; }
nav a { display: block; padding: 0.28rem 0; color: var(--quiet); text-decoration: none; }
nav a:hover { color: var(--link); text-decoration: underline; }
nav .level-3 { padding-left: 1rem; }
nav .level-4 { padding-left: 2rem; }
nav.beside { display: none; }
nav.beside p { margin: 0 0 0.5rem; font-size: 0.92rem; font-weight: 650; }
details.contents { margin: 1.2rem 0 0; padding: 0.6rem 1rem; border: 1px solid var(--line);
  border-radius: 8px;
  background: var(--raised); }
details.contents ol { padding: 0.5rem 0 0.3rem; }
summary { cursor: pointer; font-weight: 600; }
@media screen and (min-width: 76rem) {
  .body { display: grid; grid-template-columns: 14.5rem minmax(0, 1fr); column-gap: 3.5rem; }
  nav.beside { display: block; position: sticky; top: 0; align-self: start; max-height: 100vh;
    padding: 2.4rem 0.5rem 2rem 0; overflow-y: auto; }
  details.contents { display: none; }
}

.highlights { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(11.5rem, 100%), 1fr));
  gap: 0.9rem; margin: 1.4rem 0 1.8rem; padding: 0; max-width: none; list-style: none; }
.highlights li { margin: 0; padding: 0.9rem 1.1rem 1rem; border: 1px solid var(--line); border-radius: 10px;
  background: var(--raised); line-height: 1.42; }
.highlights strong { display: block; margin-bottom: 0.15rem; font-size: 1.75rem; font-weight: 650;
  line-height: 1.25; font-variant-numeric: tabular-nums; }
.highlights .agree { background: var(--agree-back); border-color: transparent; }
.highlights .differ { background: var(--differ-back); border-color: transparent; }
.highlights .unsure { background: var(--unsure-back); border-color: transparent; }
.agree > strong { color: var(--agree); }
.differ > strong { color: var(--differ); }
.unsure > strong { color: var(--unsure); }

.table { margin: 1.4rem 0 2rem; overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.93rem; line-height: 1.45;
  font-variant-numeric: tabular-nums; }
.wordy table { width: 100%; }
caption { padding: 0 0 0.6rem; text-align: left; color: var(--quiet); caption-side: top; }
caption > span { position: sticky; left: 0; display: inline-block;
  max-width: min(46rem, calc(100vw - 2rem)); }
th, td { padding: 0.55rem 0.9rem; border-bottom: 1px solid var(--line); text-align: left;
  vertical-align: top; }
th:first-child { padding-left: 0.2rem; }
thead th { border-bottom: 2px solid var(--line); background: var(--page); font-weight: 650;
  vertical-align: bottom; }
tbody th { font-weight: 400; }
.wordy tbody th { min-width: 12.5rem; }
.wordy td { min-width: 8rem; }
.wordy th, .wordy td { overflow-wrap: anywhere; }
.right { text-align: right; }
.center { text-align: center; }
td.right, tbody th.right { white-space: nowrap; }
.wordy .right { min-width: 6rem; white-space: normal; }
.tone { display: inline-block; padding: 0.08rem 0.6rem; border-radius: 1rem; font-weight: 600; }
td > .tone, th > .tone { white-space: nowrap; }
.tone.agree { color: var(--agree); background: var(--agree-back); }
.tone.differ { color: var(--differ); background: var(--differ-back); }
.tone.unsure { color: var(--unsure); background: var(--unsure-back); }
details.folded { margin: 1.4rem 0; }
details.folded summary { color: var(--quiet); font-weight: 400; }
details.folded .table { margin-top: 0.8rem; }
details.folded caption { position: absolute; width: 1px; height: 1px; overflow: hidden;
  clip-path: inset(50%); }
@media screen and (min-width: 76rem) {
  .pinned.table { overflow: visible; }
  .pinned thead th { position: sticky; top: 0; z-index: 1; }
}
@media screen and (max-width: 47.99rem) {
  .wordy table, .wordy caption, .wordy tbody, .wordy tr, .wordy tbody th, .wordy td { display: block; }
  .wordy thead { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
  .wordy tr { margin-bottom: 0.9rem; padding: 0.8rem 1rem; border: 1px solid var(--line);
    border-radius: 10px; }
  .wordy tbody th, .wordy td { min-width: 0; padding: 0.2rem 0; border: 0; text-align: left; }
  .wordy tbody th { font-weight: 600; }
  .wordy td:empty { display: none; }
  .wordy td::before { content: attr(data-label) " "; display: block; color: var(--quiet);
    font-size: 0.84rem; }
}

figure { margin: 1.6rem 0 2.2rem; max-width: 62rem; }
figure img { display: block; width: 100%; height: auto; padding: clamp(0.3rem, 1vw, 0.8rem);
  border: 1px solid var(--frame); border-radius: 10px; background: #ffffff; }
figcaption { max-width: 46rem; margin-top: 0.7rem; color: var(--quiet); font-size: 0.95rem;
  line-height: 1.5; }
figcaption .files { white-space: nowrap; }
.side-by-side { display: grid; gap: 0 1.5rem; margin: 1.6rem 0 2.2rem; }
.side-by-side figure { margin: 0 0 1.2rem; }
@media print, (min-width: 48rem) {
  .columns-2 { grid-template-columns: repeat(2, minmax(0, 1fr)); }
  .columns-3 { grid-template-columns: repeat(3, minmax(0, 1fr)); }
  .columns-4 { grid-template-columns: repeat(4, minmax(0, 1fr)); }
}

@media print {
  @page { margin: 16mm 15mm; }
  html { font-size: 9.5pt; }
  body { max-width: none; padding: 0; line-height: 1.45; }
  body > header { padding-top: 0; }
  nav.beside, details.contents, .skip { display: none; }
  h2, h3, h4, caption, thead tr, summary { break-after: avoid; }
  h2 { margin-top: 1.8rem; }
  figure { margin: 1rem 0 1.4rem; }
  figure img { width: auto; max-width: 100%; max-height: 88mm; }
  figure, tr, .highlights li, pre { break-inside: avoid; }
  .table, pre { overflow: visible; }
  pre { white-space: pre-wrap; }
  th, td { padding: 0.35rem 0.6rem; }
  thead { display: table-header-group; }
  details::details-content { content-visibility: visible; block-size: auto; }
  .tone, .highlights li { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
}
"""
