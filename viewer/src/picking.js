// The node under the pointer: the nearest on the screen, of those near one another the one in front.

const NEAR = 14;

export function nodeAt(stage, actor, x, y) {
  const { body } = actor, at = [0, 0, 0];
  let best = -1, least = Infinity;
  for (let node = 0; node < body.real; node++) {
    const [px, py, depth] = stage.project(actor.placeOf(node, at), actor.shift);
    const away = Math.hypot(px - x, py - y);
    if (away > NEAR) continue;
    const score = away + 400 * depth; // 14 px are worth 0.035 of the depth of the scene
    if (score < least) { least = score; best = node; }
  }
  return best;
}
