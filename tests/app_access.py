"""What the tests of keyboard and contrast share: controls that the tabulator key misses, and pale texts."""

CONTROLS = """() => Array.from(document.querySelectorAll(
        'button, input, a, [role=tab], [role=slider], [tabindex="0"]'))
    .filter((one) => one.offsetParent && !one.disabled && one.getAttribute('aria-hidden') !== 'true'
        && getComputedStyle(one).visibility !== 'hidden')
    .map((one, k) => { one.dataset.control = k; return String(k); })"""
# Of a group of tabs the chosen one takes the focus; arrow keys move it to the others.
GROUPED = """() => Array.from(document.querySelectorAll('[role=tab]'))
    .map((one) => one.dataset.control)"""
NAMES = """(keys) => keys.map((k) =>
    document.querySelector(`[data-control='${k}']`).outerHTML.slice(0, 200))"""
FOLLOW_FOCUS = """() => {
    window.reached = [];
    document.addEventListener('focusin', (event) => {
        if (event.target.dataset.control) window.reached.push(event.target.dataset.control);
    });
    document.activeElement.blur();
    document.body.focus();
}"""
AT_ONCE = 20
"""Presses of a key between two looks at what was reached: a look takes as long as a press."""
KINDS_OF_BUTTONS = """() => {
    const first = new Map();
    for (const one of document.querySelectorAll('.v-btn:not([disabled])'))
        if (one.offsetParent && getComputedStyle(one).visibility !== 'hidden' && !first.has(one.className))
            first.set(one.className, one);
    return Array.from(first.values()).map((one, k) => { one.dataset.kind = k; return String(k); });
}"""
"""Marks one enabled button of each look."""
CONTRAST = """() => {
    const channel = (v) => (v / 255 <= 0.04045 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4);
    const luminance = (c) => 0.2126 * channel(c[0]) + 0.7152 * channel(c[1]) + 0.0722 * channel(c[2]);
    const parse = (text) => {
        const n = (text.match(/[\\d.]+/g) || [0, 0, 0, 0]).map(Number);
        return n.length < 4 ? [...n, 1] : n;
    };
    const over = (top, under) => [0, 1, 2].map((k) => top[k] * top[3] + under[k] * (1 - top[3]));
    const parents = (element) => {
        const found = [];
        for (let e = element; e; e = e.parentElement) found.push(e);
        return found;
    };
    const veils = (e) => Array.from(e.children).filter((one) => one.matches('.v-btn__overlay'))  // of hover and focus
        .map((one) => [one, getComputedStyle(one)])
        .map(([, style]) => [...parse(style.backgroundColor).slice(0, 3), Number(style.opacity)]);
    const ground = (element) => parents(element)
        .flatMap((e) => [...veils(e), parse(getComputedStyle(e).backgroundColor)]).reverse()
        .reduce((under, top) => over(top, under), [255, 255, 255]);
    const opacity = (element) => parents(element)
        .reduce((so_far, e) => so_far * getComputedStyle(e).opacity, 1);
    const contrast = (element, colour, seen) => {
        const back = ground(element), ink = over([...colour.slice(0, 3), colour[3] * seen], back);
        const [a, b] = [luminance(ink), luminance(back)].sort((x, y) => y - x);
        return (a + 0.05) / (b + 0.05);
    };
    const skipped = '.js-plotly-plot, style, script';
    const found = [];
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    for (let node = walker.nextNode(); node; node = walker.nextNode()) {
        const element = node.parentElement, text = node.textContent.trim();
        if (!text || !element.offsetParent || element.closest(skipped)) continue;
        const style = getComputedStyle(element), seen = opacity(element);
        if (style.visibility === 'hidden' || style.display === 'none' || seen < 0.05) continue;
        const ratio = contrast(element, parse(style.color), seen);
        if (ratio < 4.5) found.push(`${text.slice(0, 40)}: ${ratio.toFixed(2)}`);
    }
    for (const field of document.querySelectorAll('input[placeholder]')) {
        const style = getComputedStyle(field, '::placeholder'), seen = opacity(field) * style.opacity;
        if (field.value || !field.offsetParent || seen < 0.05) continue;
        const ratio = contrast(field, parse(style.color), seen);
        if (ratio < 4.5) found.push(`${field.placeholder}: ${ratio.toFixed(2)}`);
    }
    return found;
}"""


def missed_controls(page) -> list[str]:
    """Controls of the page that the tabulator key does not reach."""
    wanted = page.evaluate(CONTROLS)
    page.evaluate(FOLLOW_FOCUS)
    reached: set[str] = set()
    for _ in range(4 * len(wanted) // AT_ONCE + 1):
        for _ in range(AT_ONCE):
            page.keyboard.press("Tab")
        reached = set(page.evaluate("() => window.reached"))
        if reached >= set(wanted):
            break
    tabs = set(page.evaluate(GROUPED))
    assert reached & tabs, "the tabulator key reaches no tab"
    return page.evaluate(NAMES, sorted(set(wanted) - reached - tabs))
