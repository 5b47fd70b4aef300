"""Scripts that look at a page from within: colours, contrasts, places."""

from __future__ import annotations

STRONG_COLOURS = """() => {
    // Of the plots below their legends: pixels in the full colour of a trace.
    let count = 0;
    for (const canvas of document.querySelectorAll('.plots canvas')) {
        const top = Math.ceil(30 * devicePixelRatio);
        const {data} = canvas.getContext('2d').getImageData(0, top, canvas.width, canvas.height - top);
        for (let n = 0; n < data.length; n += 4)
            if (data[n] === 0x0b && data[n + 1] === 0x57 && data[n + 2] === 0xa4 && data[n + 3] === 255) count += 1;
    }
    return count;
}"""
CONTRASTS = """() => {
    // [ratio, text, colours] of everything that has text of its own, as WCAG 2 reckons it.
    const parse = (text) => { const n = text.match(/[\\d.]+/g).map(Number); return n.length === 3 ? [...n, 1] : n; };
    const over = (top, under) => [0, 1, 2].map((k) => top[k] * top[3] + under[k] * (1 - top[3])).concat(1);
    const linear = (v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
    const light = (c) => [0, 1, 2].map((k) => linear(c[k] / 255))
        .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
    const ground = (element) => {
        const layers = [];
        for (let e = element; e; e = e.parentElement) layers.unshift(parse(getComputedStyle(e).backgroundColor));
        return layers.reduce((under, top) => over(top, under), [255, 255, 255, 1]);
    };
    const found = [];
    for (const element of document.body.querySelectorAll('*')) {
        const own = [...element.childNodes].filter((n) => n.nodeType === 3).map((n) => n.textContent.trim()).join('');
        const value = element.tagName === 'INPUT' && !['radio', 'range'].includes(element.type) ? element.value : '';
        if (!(own || value) || !element.checkVisibility({ opacityProperty: true }) || element.closest('svg')) continue;
        let ink = parse(getComputedStyle(element).color);
        for (let e = element; e; e = e.parentElement) ink[3] *= Number(getComputedStyle(e).opacity);
        const under = ground(element), a = light(over(ink, under)), b = light(under);
        found.push([(Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05), own || value, element.className]);
    }
    return found;
}"""
PLACES = """() => [...document.querySelectorAll('[data-mode], [data-number], button.stop, .filled')].map((e) => {
    const box = e.getBoundingClientRect();
    return [box.x, box.y + scrollY, box.width, box.height].map(Math.round);
})"""
