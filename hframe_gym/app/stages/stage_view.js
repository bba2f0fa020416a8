// Plan view of a machine, and motions of its tool: shapes whose points are affine functions of the tool's position.
export default {
  template: `
  <div class="stage-view">
    <div class="stage-panes">
      <figure v-for="(pane, k) in panes" :key="pane.name + k">
        <svg :viewBox="viewBox" role="img" :aria-label="'Plan view of the stage' + (pane.name ? ', ' + pane.name : '')">
          <rect v-if="workspace" class="sv-workspace" :x="workspace[0]" :y="-workspace[3]"
                :width="workspace[2] - workspace[0]" :height="workspace[3] - workspace[1]" />
          <polyline v-if="pane.motion" class="sv-trail" :points="trail(pane)" />
          <template v-for="(shape, i) in shapes" :key="i">
            <circle v-if="shape.kind === 'circle'" :class="'sv-' + shape.role" :r="shape.role === 'motor' ? 0.026 : 0.014"
                    :cx="place(shape.points[0], pane)[0]" :cy="place(shape.points[0], pane)[1]" />
            <polygon v-else-if="shape.kind === 'box'" :class="'sv-' + shape.role" :points="line(shape, pane)" />
            <polyline v-else :class="'sv-' + shape.role" :points="line(shape, pane)" />
          </template>
          <g v-if="pane.motion" class="sv-goal" :transform="goal(pane)">
            <circle r="0.016" /><path d="M-0.026 0H0.026M0-0.026V0.026" />
          </g>
        </svg>
        <figcaption v-if="pane.motion"><b>{{ pane.name }}</b> {{ distance(pane) }}</figcaption>
      </figure>
    </div>
    <div v-if="frames > 1" class="stage-player">
      <button type="button" class="sv-button" @click="toggle" :aria-label="playing ? 'Pause' : 'Play'">
        {{ playing ? 'Pause' : 'Play' }}</button>
      <input type="range" min="0" :max="frames - 1" step="1" v-model.number="frame" aria-label="Time" @input="playing = false">
      <output>{{ (frame * frame_s).toFixed(2) }} s</output>
      <label>speed <select v-model.number="speed" aria-label="Speed">
        <option v-for="s in [1, 0.5, 0.2, 0.1]" :key="s" :value="s">{{ s }}</option></select></label>
    </div>
  </div>`,
  props: { drawing: Object, motions: Array },
  data() {
    return { frame: 0, playing: false, speed: 0.5, clock: 0 };
  },
  computed: {
    shapes() { return this.drawing.shapes; },
    workspace() { return this.drawing.axes.length > 1 ? this.drawing.workspace : null; },
    viewBox() {
      const [x0, y0, x1, y1] = this.drawing.view;
      return [x0, -y1, x1 - x0, y1 - y0].join(" ");
    },
    panes() { return this.motions && this.motions.length ? this.motions : [{ name: "", motion: null }]; },
    frames() { return Math.max(...this.panes.map((p) => (p.motion ? p.motion.tool.length : 0))); },
    frame_s() { return this.panes[0].motion ? this.panes[0].motion.frame_s : 0; },
  },
  watch: {
    motions() { this.frame = 0; },
  },
  mounted() {
    let last = 0;
    const step = (now) => {
      if (this.playing && last) {
        this.clock += ((now - last) / 1000) * this.speed / this.frame_s;
        if (this.clock >= this.frames - 1) { this.clock = this.frames - 1; this.playing = false; }
        this.frame = Math.floor(this.clock);
      }
      last = now;
      this.request = requestAnimationFrame(step);
    };
    this.request = requestAnimationFrame(step);
  },
  unmounted() { cancelAnimationFrame(this.request); },
  methods: {
    toggle() {
      if (!this.playing && this.frame >= this.frames - 1) this.frame = 0;
      this.clock = this.frame;
      this.playing = !this.playing;
    },
    sample(list) { return list[Math.min(this.frame, list.length - 1)]; },
    tool(pane) {
      if (!pane.motion) return this.drawing.rest;
      return this.sample(pane.motion.tool);
    },
    place(p, pane) {
      const [x, y] = this.tool(pane);
      return [p[0] + p[1] * x + p[2] * (y || 0), -(p[3] + p[4] * x + p[5] * (y || 0))];
    },
    line(shape, pane) { return shape.points.map((p) => this.place(p, pane).map((v) => v.toFixed(4)).join(",")).join(" "); },
    trail(pane) {
      return pane.motion.tool.slice(0, this.frame + 1).map((p) => p[0].toFixed(4) + "," + (-(p[1] || 0)).toFixed(4)).join(" ");
    },
    goal(pane) {
      const g = this.sample(pane.motion.goal);
      return "translate(" + g[0] + " " + -(g[1] || 0) + ")";
    },
    distance(pane) {
      return this.sample(pane.motion.distance).toFixed(2) + " " + pane.motion.unit + " from the goal";
    },
  },
};
