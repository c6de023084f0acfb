// Rows of buttons that are one stop of the Tab key, of reports and of the tuning page.

const STOPS = "button, a[href], input[type=checkbox]";

/** Make the buttons and links of a part one stop of the Tab key; ↑ and ↓ lead to the others. */
export function oneTabStop(part) {
  const all = () => [...part.querySelectorAll(STOPS)];
  const shown = () => all().filter((each) => each.offsetParent !== null && !each.disabled);
  const stopAt = (chosen) => all().forEach((each) => { each.tabIndex = each === chosen ? 0 : -1; });
  part.addEventListener("focusin", (event) => { if (event.target.matches(STOPS)) stopAt(event.target); });
  part.addEventListener("keydown", (event) => {
    const way = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    const present = shown();
    const at = present.indexOf(event.target);
    if (!way || at < 0) return;
    event.preventDefault();
    present[(at + way + present.length) % present.length].focus();
  });
  // What was the stop may have gone, and others may have come, when somebody tabs.
  addEventListener("keydown", (event) => {
    if (event.key !== "Tab") return;
    const stops = shown();
    if (stops.filter((each) => each.tabIndex === 0).length !== 1) stopAt(stops[0]);
  }, { capture: true });
}
