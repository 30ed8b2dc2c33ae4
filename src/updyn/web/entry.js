// An input that keeps what the user types while it has the focus: a value that the server sends meanwhile would replace
// it. When the focus leaves, typed text is kept; without any, the value of the server is shown.
export default {
  template: `<q-input ref="qRef" :model-value="text" @update:model-value="type" @focus="enter" @blur="leave"
    v-bind="$attrs" />`,
  props: { value: String, id: String, _autocomplete: Array },
  emits: ["update:value"],
  data() { return { text: this.value, hasFocus: false, isTyped: false }; },
  watch: { value: "updateValue" },
  methods: {
    enter() { this.hasFocus = true; this.isTyped = false; },
    leave() {
      this.hasFocus = false;
      if (!this.isTyped) this.text = this.value;
      else if (this.text !== this.value) this.send();
    },
    type(text) { this.isTyped = true; this.text = text; this.send(); },
    send() {
      const element = mounted_app.elements[this.id.slice(1)];
      if (element) element.props.value = this.text;
      this.$emit("update:value", this.text);
    },
    updateValue() { if (!this.hasFocus) this.text = this.value; },
  },
};
