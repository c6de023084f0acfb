// Groups of elements that are one stop of the Tab key.

const STOPS = "button, a[href], input[type=checkbox], summary";

/**
 * Make the buttons and links of a part one stop of the Tab key; ↑ and ↓ move between them.
 * @param {Element} part
 * @param {string} [stops] selector of the elements, default buttons and links
 * @param {Element} [among] element within which ↑ and ↓ move, default the part
 */
export function oneTabStop(part, stops = STOPS, among = part) {
  const all = (within = part) => [...within.querySelectorAll(stops)];
  const shown = (within) => all(within).filter((each) => each.checkVisibility() && !each.disabled);
  const stopAt = (chosen) => all().forEach((each) => { each.tabIndex = each === chosen ? 0 : -1; });
  part.addEventListener("focusin", (event) => { if (event.target.matches(stops)) stopAt(event.target); });
  part.addEventListener("keydown", (event) => {
    const way = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    const present = shown(among);
    const at = present.indexOf(event.target);
    if (!way || at < 0) return;
    event.preventDefault();
    present[(at + way + present.length) % present.length].focus();
  });
  // Elements may have been added or removed since the last Tab.
  addEventListener("keydown", (event) => {
    const present = shown();
    if (event.key !== "Tab" || present.includes(document.activeElement)) return;
    const current = present.find((each) => each.getAttribute("aria-current") === "true");
    const stop = present.filter((each) => each.tabIndex === 0);
    if (current || stop.length !== 1) stopAt(current ?? present[0]);
  }, { capture: true });
}
