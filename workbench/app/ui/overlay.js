// Marks over figures, and the brush: what changes with each click is drawn here, above the image of plotly,
// so that neither a chart nor a scene is computed again. Everything follows zoom and camera of its figure.
(() => {
    const times = (m, v) => [0, 1, 2, 3].map((i) => m[i] * v[0] + m[4 + i] * v[1] + m[8 + i] * v[2] + m[12 + i] * v[3]);

    // How a scene is seen: `at` gives the place in px of a point in mm, null behind the camera; `key` changes with it.
    const seenInSpace = (scene, frame) => {
        const {model, view, projection} = scene.glplot.cameraParams, scale = scene.dataScale;
        const box = scene.container.getBoundingClientRect();
        const area = {left: box.left - frame.left, top: box.top - frame.top, width: box.width, height: box.height};
        const at = (x, y, z) => {
            const point = [x * scale[0], y * scale[1], z * scale[2], 1];
            const [a, b, , w] = [model, view, projection].reduce((v, m) => times(m, v), point);
            const left = area.left + (0.5 + 0.5 * a / w) * area.width, top = area.top + (0.5 - 0.5 * b / w) * area.height;
            return w > 0 ? [left, top] : null;
        };
        const key = [model, view, projection, scale].map((one) => Array.from(one).join()).join();
        return {area, at, key: key + Object.values(area).join()};
    };
    const seenInPlane = ({xaxis, yaxis}, frame, plot) => {
        const box = plot.getBoundingClientRect();
        const left = box.left - frame.left + xaxis._offset, top = box.top - frame.top + yaxis._offset;
        const area = {left, top, width: xaxis._length, height: yaxis._length};
        const at = (x, y) => [left + xaxis.c2p(x), top + yaxis.c2p(y)];
        return {area, at, key: [...xaxis.range, ...yaxis.range, ...Object.values(area)].join()};
    };
    const seenBy = (element) => {
        const plot = element.parentElement.querySelector('.js-plotly-plot'), layout = plot?._fullLayout;
        const frame = element.parentElement.getBoundingClientRect(), scene = layout?.scene?._scene;
        if (scene) return scene.glplot?.cameraParams?.view && scene.dataScale ? seenInSpace(scene, frame) : null;
        return layout?.xaxis?._length ? seenInPlane(layout, frame, plot) : null;
    };

    const numbers = (text) => new Float64Array(Uint8Array.from(atob(text), (one) => one.charCodeAt(0)).buffer);
    const layersOf = (canvas) => {
        const text = canvas.dataset.layers || '[]';
        if (canvas.layersText !== text) {
            canvas.layersText = text;
            canvas.layers = JSON.parse(text).map((one) => ({...one, places: one.places.map(numbers)}));
            canvas.version = (canvas.version || 0) + 1;
        }
        return canvas.layers;
    };
    const traceLine = (pen, layer, at) => {
        let isDown = false;
        pen.beginPath();
        for (let k = 0; k < layer.places[0].length; k++) {
            const place = Number.isNaN(layer.places[0][k]) ? null : at(...layer.places.map((one) => one[k]));
            if (place) pen[isDown ? 'lineTo' : 'moveTo'](...place);
            isDown = Boolean(place);
        }
    };
    const traceMarks = (pen, layer, at) => {
        const r = layer.size / 2;
        pen.beginPath();
        for (let k = 0; k < layer.places[0].length; k++) {
            const place = at(...layer.places.map((one) => one[k]));
            if (!place) continue;
            const [x, y] = place;
            pen.moveTo(x + r, y);
            if (layer.shape === 'diamond') for (const [a, b] of [[0, r], [-r, 0], [0, -r], [r, 0]]) pen.lineTo(x + a, y + b);
            else pen.arc(x, y, r, 0, 2 * Math.PI);
        }
    };
    const paintLayer = (pen, layer, at) => {
        (layer.kind === 'line' ? traceLine : traceMarks)(pen, layer, at);
        if (layer.fill) { pen.fillStyle = layer.fill; pen.fill(); }
        if (layer.width) { pen.strokeStyle = layer.colour; pen.lineWidth = layer.width; pen.stroke(); }
    };
    const paint = (canvas) => {
        const layers = layersOf(canvas), seen = seenBy(canvas);
        const ratio = Math.max(1, Math.min(window.devicePixelRatio, 2));
        const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
        const key = `${canvas.version} ${width} ${height} ${seen && seen.key}`;
        if (canvas.paintedKey === key) return;
        canvas.paintedKey = key;
        [canvas.width, canvas.height] = [width, height];
        if (!seen) return;
        const pen = canvas.getContext('2d'), {left, top, width: across, height: down} = seen.area;
        pen.scale(ratio, ratio);
        pen.beginPath();
        pen.rect(left, top, across, down);
        pen.clip();
        pen.lineJoin = pen.lineCap = 'round';
        for (const layer of layers) paintLayer(pen, layer, seen.at);
    };

    const put = (mark) => {
        const seen = seenBy(mark), at = seen && seen.at(...['x', 'y', 'z'].map((axis) => Number(mark.dataset[axis])));
        const {left, top, width, height} = seen ? seen.area : {};
        const isInside = at && at[0] >= left && at[0] <= left + width && at[1] >= top && at[1] <= top + height;
        if (isInside) mark.style.transform = `translate(${at[0].toFixed(1)}px, ${at[1].toFixed(1)}px)`;
        mark.style.visibility = isInside ? 'inherit' : 'hidden';
    };

    // plotly sets the viewBox of the axis labels of a scene, and the labels of the axes of a chart, in each frame that
    // it draws, before the frame is painted. A loop over all frames would have the browser work while nothing moves.
    const canvases = document.getElementsByClassName('marks-over-figure');
    const marks = document.getElementsByClassName('mark-in-space');
    const follow = new MutationObserver(() => {
        for (const canvas of canvases) paint(canvas);
        for (const mark of marks) put(mark);
    });
    const attributeFilter = ['viewBox', 'data-layers', 'data-x', 'data-y', 'data-z', 'transform'];
    follow.observe(document.body, {childList: true, subtree: true, attributes: true, attributeFilter});

    // A brush: drag over a chart. `done` gets the ends of the rectangle in the units of the axes.
    const LEAST_PX = 6;
    window.brushFigure = (down, done) => {
        const target = down.target.closest?.('.nsewdrag');
        if (!target || down.button !== 0) return;
        const {xaxis, yaxis} = down.currentTarget.querySelector('.js-plotly-plot')._fullLayout;
        const area = target.getBoundingClientRect(), box = document.createElement('div');
        const inside = ({clientX, clientY}) => [
            Math.min(Math.max(clientX - area.left, 0), area.width), Math.min(Math.max(clientY - area.top, 0), area.height)];
        const first = inside(down);
        const move = (event) => {
            const at = inside(event), sides = [0, 1].map((k) => Math.abs(at[k] - first[k]));
            if (!box.isConnected && Math.max(...sides) < LEAST_PX) return;
            const [left, top] = [area.left + Math.min(at[0], first[0]), area.top + Math.min(at[1], first[1])];
            box.className = 'brush';
            box.style.cssText = `left: ${left}px; top: ${top}px; width: ${sides[0]}px; height: ${sides[1]}px`;
            if (!box.isConnected) document.body.appendChild(box);
        };
        const listening = new AbortController(), options = {capture: true, signal: listening.signal};
        const end = (event) => {
            listening.abort();
            if (!box.isConnected) return;
            box.remove();
            const at = inside(event), range = (axis, k) => [axis.p2c(first[k]), axis.p2c(at[k])];
            if (event.type === 'pointerup') done({x: range(xaxis, 0), y: range(yaxis, 1)});
        };
        addEventListener('pointermove', move, options);
        addEventListener('pointerup', end, options);
        addEventListener('pointercancel', end, options);
        addEventListener('keydown', (event) => event.key === 'Escape' && end(event), options);
    };

    // A line that is dragged across a chart: `done` gets the place of the pointer in the units of the x axis, where the
    // mouse is pressed and with each movement until it is released.
    window.dragLine = (down, done) => {
        const target = down.target.closest?.('.nsewdrag');
        if (!target || down.button !== 0) return;
        const {xaxis} = down.currentTarget.querySelector('.js-plotly-plot')._fullLayout;
        const area = target.getBoundingClientRect();
        const put = ({clientX}) => done(xaxis.p2c(Math.min(Math.max(clientX - area.left, 0), area.width)));
        const listening = new AbortController(), options = {capture: true, signal: listening.signal};
        addEventListener('pointermove', put, options);
        for (const name of ['pointerup', 'pointercancel']) addEventListener(name, () => listening.abort(), options);
        put(down);
    };
})();
