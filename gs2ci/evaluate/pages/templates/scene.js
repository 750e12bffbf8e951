// The scene and its cameras in a box of the page: Gaussians as ellipses, sorted and blended from back to front, in WebGL 2.
// Colours of a fit lie beyond 0 to 1, too, and are cut only when all is blended, where half-precision pictures can be drawn.
// Data: see scene_view.py. All lengths are in distances of the middle camera from what it looks at, which is the origin.
(() => {
  "use strict";
  const ELLIPSES = `#version 300 es
  precision highp float; precision highp sampler2D;
  uniform sampler2D shapes, colours; uniform mat3 turn; uniform vec2 focal, shift, pixels; uniform float away, widened;
  in vec2 corner; in uint number; out vec2 at; out vec4 shade;
  float part(uint k) { int i = int(number * 9u + k); return texelFetch(shapes, ivec2(i % 2304, i / 2304), 0).r; }
  void main() {
    vec3 seen = turn * vec3(part(0u), part(1u), part(2u)) + vec3(0, 0, away);
    shade = texelFetch(colours, ivec2(int(number % 256u), int(number / 256u)), 0) * vec4(2, 2, 2, 1) - vec4(0.5, 0.5, 0.5, 0);
    gl_Position = vec4(0, 0, 2, 1);
    if (seen.z < 0.05) return;
    mat3 own = mat3(part(3u), part(4u), part(5u), part(4u), part(6u), part(7u), part(5u), part(7u), part(8u)) * 1e-4;
    mat3 slope = mat3(focal.x / seen.z, 0, 0, 0, focal.y / seen.z, 0, -focal.x * seen.x / (seen.z * seen.z), -focal.y * seen.y / (seen.z * seen.z), 0);
    mat3 onto = slope * turn, spread = onto * own * transpose(onto);
    float a = spread[0][0] + widened, b = spread[0][1], d = spread[1][1] + widened;
    float mean = 0.5 * (a + d), half_gap = sqrt(max(0.25 * (a - d) * (a - d) + b * b, 1e-9));
    float longest = min(mean + half_gap, 1e6), shortest = max(mean - half_gap, 0.1);
    vec2 axis = abs(b) < 1e-6 ? (a >= d ? vec2(1, 0) : vec2(0, 1)) : normalize(vec2(b, longest - a));
    at = corner * 3.0;
    vec2 offset = at.x * sqrt(longest) * axis + at.y * sqrt(shortest) * vec2(-axis.y, axis.x);
    vec2 place = focal * seen.xy / seen.z + shift + offset;
    gl_Position = vec4(2.0 * place / pixels * vec2(1, -1), 0, 1);
  }`;
  const BLEND = `#version 300 es
  precision mediump float; in vec2 at; in vec4 shade; out vec4 light;
  void main() { float a = shade.a * exp(-0.5 * dot(at, at)); if (a < 0.004) discard; light = vec4(shade.rgb * a, a); }`;
  const CORNERS = `#version 300 es
  in vec2 corner; void main() { gl_Position = vec4(corner, 0, 1); }`;
  const CUT = `#version 300 es
  precision highp float; uniform highp sampler2D blended; out vec4 light;
  void main() { light = texelFetch(blended, ivec2(gl_FragCoord.xy), 0); light = vec4(clamp(light.rgb, 0.0, 1.0), 1); }`;
  const LINES = `#version 300 es
  uniform mat3 turn; uniform vec2 focal, shift, pixels; uniform float away; in vec3 place;
  void main() { vec3 s = turn * place + vec3(0, 0, away); gl_Position = vec4(2.0 * (focal * s.xy + shift * s.z) / pixels * vec2(1, -1), s.z - 0.24, s.z); }`; // none nearer than 0.12: one looks through the cameras at first;
  const INK = `#version 300 es
  precision mediump float; uniform vec4 ink; out vec4 light; void main() { light = vec4(ink.rgb * ink.a, ink.a); }`;

  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const half = (h) => {
    const e = (h >> 10) & 31, m = h & 1023, s = h & 32768 ? -1 : 1;
    return s * (e ? 2 ** (e - 15) * (1 + m / 1024) : 2 ** -14 * (m / 1024));
  };

  function program(gl, vertex, fragment) {
    const made = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(made));
    return { made, of: (name) => gl.getUniformLocation(made, name), at: (name) => gl.getAttribLocation(made, name) };
  }

  function texture(gl, unit, width, rows, inner, format, kind, data) {
    gl.activeTexture(gl.TEXTURE0 + unit);
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, inner, width, rows, 0, format, kind, data);
    return made;
  }

  function start(box) {
    const canvas = box.querySelector("canvas"), gl = canvas.getContext("webgl2", { antialias: true, premultipliedAlpha: true });
    if (!gl) { box.classList.add("without"); return; }
    const shapeBytes = bytes(box.dataset.shapes), count = shapeBytes.length / 18;
    const shapes = new Uint16Array(shapeBytes.buffer), shades = bytes(box.dataset.colours);
    const lines = new Float32Array(bytes(box.dataset.cameras).buffer);
    const lens = box.dataset.lens.split(" ").map(Number), [across, down] = box.dataset.size.split(" ").map(Number);
    const rows = Math.max(1, Math.ceil(count / 256)), shapeTexels = new Uint16Array(rows * 2304), shadeTexels = new Uint8Array(rows * 1024);
    shapeTexels.set(shapes); shadeTexels.set(shades);
    const places = new Float32Array(3 * count);
    for (let k = 0; k < count; k++) for (let axis = 0; axis < 3; axis++) places[3 * k + axis] = half(shapes[9 * k + axis]);
    const ellipses = program(gl, ELLIPSES, BLEND), wires = program(gl, LINES, INK), cut = program(gl, CORNERS, CUT);
    const beyond = gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float");
    const picture = beyond && gl.createFramebuffer();
    let blended = null;
    texture(gl, 0, 2304, rows, gl.R16F, gl.RED, gl.HALF_FLOAT, shapeTexels);
    texture(gl, 1, 256, rows, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, shadeTexels);
    const buffer = (data, usage) => { const b = gl.createBuffer(); gl.bindBuffer(gl.ARRAY_BUFFER, b); gl.bufferData(gl.ARRAY_BUFFER, data, usage); return b; };
    const attach = (place, of, size) => { gl.bindBuffer(gl.ARRAY_BUFFER, of); gl.enableVertexAttribArray(place); gl.vertexAttribPointer(place, size, gl.FLOAT, false, 0, 0); };
    const corners = buffer(new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW), wire = buffer(lines, gl.STATIC_DRAW);
    const order = new Uint32Array(count), halfway = new Uint32Array(count), numbers = buffer(order, gl.DYNAMIC_DRAW);
    const depths = new Float32Array(count), bits = new Uint32Array(depths.buffer), begins = new Uint32Array(65537);
    const first = { yaw: 0, pitch: 0, away: 1 }, state = { ...first };
    let wanted = false;

    function turned() {
      const [cy, sy, cp, sp] = [Math.cos(state.yaw), Math.sin(state.yaw), Math.cos(state.pitch), Math.sin(state.pitch)];
      // Columns, as WebGL counts: about the vertical, then about the horizontal.
      return [cy, sp * sy, -cp * sy, 0, cp, sp, sy, -sp * cy, cp * cy];
    }

    // By the bits of their depths, which count as the depths do: the farthest first, equal ones in their order. Twice 16 bits.
    function sort(turn) {
      for (let k = 0; k < count; k++) {
        depths[k] = turn[2] * places[3 * k] + turn[5] * places[3 * k + 1] + turn[8] * places[3 * k + 2];
        if (bits[k] < 0x80000000) bits[k] = ~bits[k] & 0x7fffffff;
        order[k] = k;
      }
      for (const [from, to, low] of [[order, halfway, 0], [halfway, order, 16]]) {
        begins.fill(0);
        for (let k = 0; k < count; k++) begins[((bits[k] >>> low) & 65535) + 1]++;
        for (let k = 1; k < 65536; k++) begins[k] += begins[k - 1];
        for (let k = 0; k < count; k++) to[begins[(bits[from[k]] >>> low) & 65535]++] = from[k];
      }
    }

    function draw() {
      wanted = false;
      const ratio = Math.min(devicePixelRatio || 1, 2), width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
      if (canvas.width !== width || canvas.height !== height || picture && !blended) {
        canvas.width = width; canvas.height = height;
        if (picture) {
          gl.deleteTexture(blended);
          blended = texture(gl, 2, width, height, gl.RGBA16F, gl.RGBA, gl.HALF_FLOAT, null);
          gl.bindFramebuffer(gl.FRAMEBUFFER, picture);
          gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, blended, 0);
        }
      }
      const turn = turned(), [focal_x, focal_y, middle_x, middle_y] = lens;
      // The whole of the middle view fits into the box, whatever the box's shape.
      const scale = Math.min(width / across, height / down);
      // What the fit added to the variances in pixels of its views is as wide in a larger picture.
      const widened = Number(box.dataset.widened) * Math.max(1, scale) ** 2;
      gl.bindFramebuffer(gl.FRAMEBUFFER, picture || null);
      // Black, as in the fit: where no light comes from, dark things are often left transparent.
      gl.viewport(0, 0, width, height); gl.clearColor(0, 0, 0, 1); gl.clear(gl.COLOR_BUFFER_BIT);
      gl.enable(gl.BLEND); gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      for (const drawn of [ellipses, wires]) {
        gl.useProgram(drawn.made);
        gl.uniformMatrix3fv(drawn.of("turn"), false, turn); gl.uniform2f(drawn.of("focal"), focal_x * scale, focal_y * scale);
        gl.uniform2f(drawn.of("shift"), (middle_x - across / 2) * scale, (middle_y - down / 2) * scale);
        gl.uniform2f(drawn.of("pixels"), width, height); gl.uniform1f(drawn.of("away"), state.away); gl.uniform1f(drawn.of("widened"), widened);
      }
      if (count) {
        sort(turn);
        gl.useProgram(ellipses.made); gl.uniform1i(ellipses.of("shapes"), 0); gl.uniform1i(ellipses.of("colours"), 1);
        const corner = ellipses.at("corner"), number = ellipses.at("number");
        attach(corner, corners, 2); gl.vertexAttribDivisor(corner, 0);
        gl.bindBuffer(gl.ARRAY_BUFFER, numbers); gl.bufferSubData(gl.ARRAY_BUFFER, 0, order);
        gl.enableVertexAttribArray(number); gl.vertexAttribIPointer(number, 1, gl.UNSIGNED_INT, 0, 0); gl.vertexAttribDivisor(number, 1);
        gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
        gl.disableVertexAttribArray(corner); gl.disableVertexAttribArray(number); gl.vertexAttribDivisor(number, 0);
      }
      if (picture) {
        gl.bindFramebuffer(gl.FRAMEBUFFER, null); gl.disable(gl.BLEND);
        gl.useProgram(cut.made); gl.uniform1i(cut.of("blended"), 2);
        const corner = cut.at("corner");
        attach(corner, corners, 2);
        gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
        gl.disableVertexAttribArray(corner); gl.enable(gl.BLEND);
      }
      gl.useProgram(wires.made);
      const ink = getComputedStyle(canvas).color.match(/[\d.]+/g).map(Number);
      gl.uniform4f(wires.of("ink"), ink[0] / 255, ink[1] / 255, ink[2] / 255, 0.9);
      const place = wires.at("place");
      attach(place, wire, 3);
      gl.drawArrays(gl.LINES, 0, lines.length / 3);
      gl.disableVertexAttribArray(place);
      box.dataset.drawn = Number(box.dataset.drawn || 0) + 1;
    }

    const later = () => { if (!wanted) { wanted = true; requestAnimationFrame(draw); } };
    const move = (yaw, pitch, nearer) => {
      state.yaw += yaw;
      state.pitch = Math.min(1.5, Math.max(-1.5, state.pitch + pitch));
      state.away = Math.min(6, Math.max(0.15, state.away * nearer));
      later();
    };
    const fingers = new Map();
    const gap = () => { const [one, other] = [...fingers.values()]; return Math.hypot(one.x - other.x, one.y - other.y); };
    canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); fingers.set(event.pointerId, { x: event.clientX, y: event.clientY }); });
    canvas.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const two = fingers.size === 2, wide = two ? gap() : 0;
      fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      if (two) move(0, 0, wide / Math.max(gap(), 1));
      else if (fingers.size === 1) move((event.clientX - before.x) * -0.006, (event.clientY - before.y) * 0.006, 1);
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); move(0, 0, Math.exp(event.deltaY * 0.001)); }, { passive: false });
    const keys = { ArrowLeft: [0.1, 0, 1], ArrowRight: [-0.1, 0, 1], ArrowUp: [0, -0.1, 1], ArrowDown: [0, 0.1, 1], "+": [0, 0, 0.9], "-": [0, 0, 1.1] };
    canvas.addEventListener("keydown", (event) => { const step = keys[event.key]; if (step) { event.preventDefault(); move(...step); } });
    box.querySelector("button").addEventListener("click", () => { Object.assign(state, first); later(); });
    new ResizeObserver(later).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", later);
    canvas.addEventListener("webglcontextlost", () => box.classList.add("without"));
    later();
  }

  for (const box of document.querySelectorAll("[data-shapes]")) start(box);
})();
