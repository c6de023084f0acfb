// Shading as in media/face/shading.py: key, fill and two rim lights fixed to the camera, approximate
// subsurface light, procedural irises. Light is linear until the output. Varyings are centroid,
// because samples at the edge of a small triangle may lie outside of it.

export const FACE_VERTEX = `#version 300 es
layout(location=0) in vec3 position;
layout(location=1) in vec3 normal;
layout(location=2) in vec4 paint;   // sRGB, openness
layout(location=3) in float part;
layout(location=4) in vec3 rest;    // on an eye: relative to its centre
layout(location=5) in float reach;
layout(location=6) in float bare;
uniform mat4 view;
uniform mat4 projection;
centroid out vec3 vNormal;
centroid out vec3 vPosition;
centroid out vec3 vColor;
centroid out float vOpen;
centroid out vec3 vRest;
centroid out float vReach;
centroid out float vBare;
flat out int vPart;
void main() {
  vec4 seen = view * vec4(position, 1.0);
  vNormal = mat3(view) * normalize(normal); // unit, for unweighted interpolation
  vPosition = seen.xyz;
  vColor = pow(paint.rgb, vec3(2.2));
  vOpen = paint.a;
  vRest = rest;
  vReach = reach;
  vBare = bare;
  vPart = int(part + 0.5);
  gl_Position = projection * seen;
}`;

export const FACE_FRAGMENT = `#version 300 es
precision highp float;
centroid in vec3 vNormal;
centroid in vec3 vPosition;
centroid in vec3 vColor;
centroid in float vOpen;
centroid in vec3 vRest;
centroid in float vReach;
centroid in float vBare;
flat in int vPart;
uniform mat4 projection;
uniform float tint;
uniform int heat;
uniform vec3 ramp[5];
const int ROWS = 17; // BAND_ROWS in media/face/features.py
uniform int bandCount;
uniform vec3 bandSpans[3];  // least and largest x, edge [mm]
uniform vec3 bandColors[3];
uniform vec4 bandRows[3 * ROWS]; // y, reach above and below, least z [mm]
out vec4 color;

const int SKIN = 0;
const vec3 UNKNOWN = vec3(0.18); // grey: no value
const float GLOSS[6] = float[6](0.045, 0.9, 0.25, 0.10, 0.05, 0.0);
const float SHINE[6] = float[6](26.0, 420.0, 70.0, 40.0, 20.0, 1.0);
const vec3 SKY = vec3(0.30, 0.315, 0.345);
const vec3 GROUND = vec3(0.15, 0.13, 0.12);
const vec3 TINT = vec3(1.0, 0.42, 0.06);

vec3 iris(vec3 base) {
  vec3 d = normalize(vRest);
  float angle = atan(length(d.xy), d.z);
  float around = atan(d.y, d.x);
  float soft = max(fwidth(angle), 1e-4);
  vec3 ring = vec3(0.11, 0.15, 0.17) * (1.0 + 0.25 * cos(23.0 * around) * cos(9.0 * around));
  float shade = (angle - 0.33) / 0.19;
  ring *= clamp(1.25 - shade * shade, 0.25, 1.0);
  vec3 out_ = mix(ring, base, smoothstep(0.50 - soft, 0.50 + soft, angle));
  return mix(vec3(0.006), out_, smoothstep(0.20 - soft, 0.20 + soft, angle));
}

// Lips and brows of a face without colours.
vec3 banded(vec3 base) {
  for (int k = 0; k < bandCount; k++) {
    vec3 span = bandSpans[k];
    float along = (vRest.x - span.x) / (span.y - span.x);
    if (along <= 0.0 || along >= 1.0) continue;
    float at = along * float(ROWS - 1);
    int low = min(int(at), ROWS - 2) + k * ROWS;
    vec4 row = mix(bandRows[low], bandRows[low + 1], at - float(low - k * ROWS));
    float away = vRest.y - row.x;
    float beyond = abs(away) - (away > 0.0 ? row.y : row.z);
    float share = smoothstep(0.0, 1.0, 0.5 - beyond / span.z);
    if (vRest.z > row.w) base = mix(base, bandColors[k], clamp(vBare, 0.0, 1.0) * share);
  }
  return base;
}

vec3 lamp(vec3 n, vec3 albedo, vec3 wrap, vec3 direction, vec3 light, float reach) {
  vec3 diffuse = max((vec3(dot(n, normalize(direction))) + wrap) / (1.0 + wrap), 0.0);
  return albedo * diffuse * light * reach;
}

void main() {
  vec3 v = normalize(-vPosition);
  vec3 n = normalize(vNormal);
  // Back faces, such as the back of the head through an open mouth, are dark. gl_FrontFacing is
  // unreliable for triangles smaller than a pixel.
  bool behind = dot(n, v) < -0.25;
  if (behind) n = -n;
  float open = clamp(vOpen, 0.0, 1.0); // extrapolated at a triangle's edge
  bool skin = vPart == SKIN;
  vec3 albedo = skin ? banded(vColor) : dot(vRest, vRest) > 0.0 ? iris(vColor) : vColor;
  albedo = clamp(albedo, 0.0, 1.0) * (behind ? 0.04 : 1.0);
  vec3 opened = skin ? pow(vec3(open), vec3(0.80, 1.08, 1.18)) : vec3(open);
  vec3 wrap = skin ? vec3(0.34, 0.17, 0.10) : vec3(0.05);
  vec3 light = albedo * opened * mix(GROUND, SKY, 0.5 + 0.5 * n.y);
  vec3 key = normalize(vec3(-0.42, 0.46, 0.78));
  vec3 keyLight = vec3(1.20, 1.13, 1.05);
  // In place of cast shadows, the key light is reduced with the visible sky.
  float lit = smoothstep(0.05, 0.65, open);
  light += lamp(n, albedo, wrap, key, keyLight, lit);
  light += lamp(n, albedo, wrap, vec3(0.85, 0.05, 0.45), vec3(0.20, 0.235, 0.28), open);
  light += lamp(n, albedo, wrap, vec3(0.72, 0.45, -0.62), vec3(0.55, 0.60, 0.68), open);
  light += lamp(n, albedo, wrap, vec3(-0.85, 0.25, -0.55), vec3(0.30, 0.33, 0.37), open);
  float shine = SHINE[vPart];
  float lobe = pow(max(dot(n, normalize(v + key)), 0.0), shine);
  float facing = clamp(4.0 * dot(n, key), 0.0, 1.0);
  light += GLOSS[vPart] * (shine + 2.0) / 28.0 * lobe * facing * lit * keyLight;
  vec3 over = max(light - 0.6, 0.0);
  light = min(light, 0.6) + 0.4 * over / (over + 0.4);
  float luma = dot(light, vec3(0.21, 0.72, 0.07));
  float reach = clamp(vReach, 0.0, 1.0);
  if (heat == 0) light = mix(light, TINT * (0.15 + luma), 0.75 * tint * reach);
  else if (skin) { // colours of the ramp, slightly shaded
    float at = 4.0 * max(255.0 * reach - 1.0, 0.0) / 254.0;
    int below = min(int(at), 3);
    vec3 value = mix(ramp[below], ramp[below + 1], at - float(below));
    light = mix(UNKNOWN, value, clamp(255.0 * reach, 0.0, 1.0)) * (0.6 + 0.8 * luma);
  }
  vec3 shown = mix(12.92 * light, 1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055,
                   step(0.0031308, light));
  color = vec4(shown, 1.0);
  // Depth at the centroid: the depth slope of triangles seen edge on is so steep that extrapolated
  // samples at the rim of an eye would be in front of the skin.
  gl_FragDepth = 0.5 - 0.5 * (projection[2].z * vPosition.z + projection[3].z) / vPosition.z;
}`;

export const MARK_VERTEX = `#version 300 es
layout(location=0) in vec3 position;
layout(location=1) in vec4 paint;
uniform mat4 view;
uniform mat4 projection;
uniform float diameter;
out vec4 vColor;
void main() {
  vec3 seen = (view * vec4(position, 1.0)).xyz;
  seen *= 1.0 - 4.0 / length(seen); // 4 mm nearer, for markers just below the skin
  gl_Position = projection * vec4(seen, 1.0);
  gl_PointSize = diameter;
  vColor = paint;
}`;

export const MARK_FRAGMENT = `#version 300 es
precision highp float;
in vec4 vColor;
uniform float opacity;
uniform float diameter;
uniform bool round_;
out vec4 color;
void main() {
  float alpha = vColor.a * opacity;
  vec3 tone = vColor.rgb;
  if (round_) {
    float away = length(gl_PointCoord - 0.5) * diameter;
    float edge = 0.5 * diameter;
    alpha *= 1.0 - smoothstep(edge - 1.2, edge, away);
    tone *= 1.0 - 0.75 * smoothstep(edge - 2.6, edge - 1.4, away);
  }
  color = vec4(tone * alpha, alpha);
}`;
