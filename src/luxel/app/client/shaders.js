// The shaders. Space is normalised units relative to the eye, axes right, up, forward; so float32 is enough at any zoom.
// Under orthographic projection it is relative to the point before the eye at the target's depth: eyes are far away there.

import { PLACE, lookup } from "./lookup.js";
import { LIGHTS_MAX } from "./lightset.js";

const HEAD = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp isampler2D;
precision highp usampler2D;
precision highp sampler2DArray;
precision highp isampler2DArray;
precision highp usampler2DArray;
`;

const CAMERA = `
uniform sampler2D uSpheres;   // centre, radius
uniform vec3 uEyeHigh, uEyeLow; // two floats make a double, so that a close eye does not jump from float to float
uniform mat3 uBasis;          // columns right, up, forward
uniform vec2 uHalf;           // half extent of the picture: at distance 1, or anywhere if orthographic
uniform vec2 uSize;           // pixels
uniform vec2 uShift;          // where in its pixel a ray starts, from the centre, in pixels
uniform bool uOrthographic;
uniform float uSwell;         // factor on radii

ivec2 place(int id) { return ivec2(id & 2047, id >> 11); }

vec4 sphereAt(int id) {
  vec4 s = texelFetch(uSpheres, place(id), 0);
  return vec4(((s.xyz - uEyeHigh) - uEyeLow) * uBasis, s.w * uSwell);
}

// Nearest front face of a sphere along the ray through pixel p (lower left corner is 0), and the unit normal there.
// The distance counts along the view direction; it is far behind the eye where the ray misses.
float hit(vec4 s, vec2 p, out vec3 ray, out vec3 normal) {
  vec2 plane = ((p + uShift) / uSize * 2.0 - 1.0) * uHalf;
  ray = uOrthographic ? vec3(0, 0, 1) : vec3(plane, 1);
  float dd = dot(ray, ray);
  vec3 to = uOrthographic ? vec3(s.xy - plane, s.z) : s.xyz;
  float b = dot(to, ray) / dd;
  vec3 off = to - b * ray; // from the ray to the centre; b*b - c would cancel for small far spheres
  float rest = s.w * s.w - dot(off, off);
  if (rest < 0.0) return -1e30;
  float back = sqrt(rest / dd);
  normal = -(off + back * ray) / s.w;
  return b - back;
}
`;

/**
 * Spheres as points, one vertex each, or as quads of four. Points are the faster ones, but of limited size. Quads are not
 * instanced: that is slow for so few vertices.
 * @param {boolean} points
 */
export const idsVertex = (points) => HEAD + CAMERA + `
uniform usampler2D uList;
uniform bool uListed;
uniform int uFirst, uStride;
uniform float uStart; // where along the view direction there begins to be something to see
flat out vec4 vSphere;
flat out uint vId;

// Ends of a sphere's picture along one axis: where the two tangents from the eye meet the plane at distance 1.
// Behind the eye a tangent meets nothing; the picture then reaches to infinity, or is not there at all.
bool ends(float x, float z, float r, out vec2 range) {
  range = vec2(-1e9, 1e9);
  float dd = x * x + z * z;
  if (dd <= r * r) return true;
  float l = sqrt(dd - r * r);
  vec2 across = x * l + vec2(-z, z) * r, ahead = z * l + vec2(x, -x) * r;
  if (ahead.x > 0.0) range.x = across.x / ahead.x;
  else if (across.x > 0.0) return false;
  if (ahead.y > 0.0) range.y = across.y / ahead.y;
  else if (across.y < 0.0) return false;
  return true;
}

void main() {
  int id = uFirst + uStride * (gl_VertexID ${points ? "" : ">> 2"});
  if (uListed) id = int(texelFetch(uList, place(id), 0).r);
  vec4 s = sphereAt(id);
  vSphere = s;
  vId = uint(id) + 1u;
  vec2 low, high;
  bool shown;
  if (uOrthographic) {
    shown = s.z + s.w > uStart;
    low = s.xy - s.w;
    high = s.xy + s.w;
  } else {
    vec2 x, y;
    shown = s.z + s.w > 0.0 && dot(s.xyz, s.xyz) > s.w * s.w // from inside, a sphere shows no front face
      && ends(s.x, s.z, s.w, x) && ends(s.y, s.z, s.w, y);
    low = vec2(x.x, y.x);
    high = vec2(x.y, y.y);
  }
  vec2 pixel = 2.0 / uSize;
  low = low / uHalf - uShift * pixel - 0.02 * pixel; // the margin covers rounding
  high = high / uHalf - uShift * pixel + 0.02 * pixel;
  shown = shown && all(lessThan(low, vec2(1))) && all(greaterThan(high, vec2(-1)));
  low = clamp(low, -1.0, 1.0);
  high = clamp(high, -1.0, 1.0);
  gl_Position = vec4(2, 2, 2, 1);
  ${points ? `
  vec2 extent = 0.5 * (high - low) * uSize;
  gl_PointSize = max(extent.x, extent.y) + 0.1;
  if (shown) gl_Position = vec4(0.5 * (low + high), 0, 1);` : `
  if (shown) gl_Position = vec4(mix(low, high, vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1)), 0, 1);`}
}`;

export const IDS_FRAGMENT = HEAD + CAMERA + `
flat in vec4 vSphere;
flat in uint vId;
uniform float uNear, uFar, uStart;
out uint outId;

void main() {
  vec3 ray, normal;
  float t = hit(vSphere, gl_FragCoord.xy, ray, normal);
  if (t <= uStart) discard;
  // Reversed depth in a float buffer is as fine near as far, so there are no clip planes to fit.
  gl_FragDepth = uOrthographic ? 1.0 - (t - uStart) / uFar : min(1.0, uNear / t);
  outId = vId;
}`;

export const SCREEN_VERTEX = HEAD + `
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, -1, 1); // at depth 0: behind everything
}`;

const LAMBERT = `
float soft(float c, float s) {
  return c >= s ? c : c <= -s ? 0.0 : (c + s) * (c + s) / (4.0 * s);
}

// Unshadowed direct light in closed form; the same as luxel.kernels.light.lambert.
float lambert(vec3 p, vec3 n) {
  float sum = uSky.y + (uSky.x - uSky.y) * 0.5 * (1.0 + 2.0 / 3.0 * dot(n, uSkyAxis));
  for (int k = 0; k < SUNS; k++) {
    sum += uSuns[2 * k].w * soft(dot(n, uSuns[2 * k].xyz), uSuns[2 * k + 1].x);
  }
  for (int k = 0; k < GLOBES; k++) {
    vec4 g = uGlobes[2 * k];
    vec3 c = g.xyz - p;
    float d2 = dot(c, c), d = sqrt(d2);
    if (d2 > g.w * g.w) sum += uGlobes[2 * k + 1].x * g.w * g.w / d2 * soft(dot(n, c) / d, g.w / d);
  }
  for (int k = 0; k < QUADS; k++) {
    vec3 c = uQuads[2 * k].xyz - p;
    float d2 = max(dot(c, c), 1e-12), d = sqrt(d2);
    float facing = max(0.0, -dot(uQuads[2 * k + 1].xyz, c) / d);
    sum += uQuads[2 * k].w * max(0.0, dot(n, c) / d) * facing * uQuads[2 * k + 1].w / (PI * d2);
  }
  return sum;
}
`;

// Mean over what a ray stands for, four points around its hit; the same as luxel.kernels.shade._filtered. The fifth turn is
// for rays that lie close, and for limbs that hold none of the four.
const FILTERED = `
float filtered(int record, int generation, float radius, vec3 n, float depth, vec3 ray) {
  float gap = 2.0 * uHalf.x / uSize.x * (uOrthographic ? 1.0 : depth) / radius;
  float reach = 0.25 * gap * clamp(gap / 0.2 - 1.0, 0.0, 1.0), sum = 0.0, count = 0.0;
  vec3 d = normalize(ray);
  vec3 a = vec3(1, 0, 0) - d.x * d, b = cross(a, d), q = n - dot(n, d) * d;
  for (int k = reach > 0.0 ? 0 : 4; k < 4 || (k == 4 && count == 0.0); k++) {
    vec3 p = q + ((k & 1) != 0 ? reach : -reach) * a + ((k & 2) != 0 ? reach : -reach) * b;
    float rest = 1.0 - dot(p, p);
    if (k == 4 || rest > 0.19) { // beyond, a pixel shows more of what lies behind
      sum += textured(record, generation, uBasis * (k == 4 ? n : p - sqrt(rest) * d));
      count += 1.0;
    }
  }
  return sum / count;
}
`;

const RECORD = {
  tiles: `
uniform isampler2D uSlots;      // slot + generation << 24, or -1
int recordOf(int id, out int generation) {
  int slot = texelFetch(uSlots, place(id), 0).r;
  generation = slot >> 24;
  return slot < 0 ? -1 : slot & 0xffffff;
}
`,
  baked: `
uniform usampler2D uParts;      // whether they have come
uniform int uPart;
int recordOf(int id, out int generation) {
  generation = 0;
  return texelFetch(uParts, ivec2(0, id / uPart), 0).r != 0u ? id : -1;
}
`,
};

/**
 * Luminance and colour of what the id buffer holds; sums of samples, tone comes later. Made for what it has to do, because
 * a processor that draws in software does all that stands in a shader for every pixel, needed or not.
 * @param {ReturnType<import("./lightset.js").LightSet["traits"]> & {filtered: boolean}} traits
 */
export const shadeFragment = ({ reader, baked, complete, coarse, suns, globes, quads, filtered }) => HEAD + CAMERA + `
#define SUNS ${suns}
#define GLOBES ${globes}
#define QUADS ${quads}
uniform usampler2D uIds;
uniform sampler2D uValues;      // position in the colour map, or a packed colour; negative is no data
uniform sampler2D uLut;         // linear light
uniform sampler2D uCoarse;      // first light; red < 0 where there is none
uniform float uCoarseScale;
uniform int uCurrent;           // generation of the textures of this light
uniform bool uUniform, uPacked;
uniform vec3 uColor, uNoData;   // linear light
uniform vec2 uSky;              // level, ground
uniform vec3 uSkyAxis;
uniform vec4 uSuns[2 * ${LIGHTS_MAX}];   // direction, level | sine of half the angular diameter
uniform vec4 uGlobes[2 * ${LIGHTS_MAX}]; // centre, radius | level
uniform vec4 uQuads[2 * ${LIGHTS_MAX}];  // centre, level | normal, area
layout(location = 0) out vec4 outSum;    // luminance times linear colour, luminance
layout(location = 1) out float outCover;

const float PI = 3.14159265358979;
${LAMBERT}${reader ? PLACE + lookup(reader) + (filtered ? FILTERED : "") + (baked ? RECORD.baked : RECORD.tiles) : ""}
vec3 colorOf(int id) {
  if (uUniform) return uColor;
  float x = texelFetch(uValues, place(id), 0).r;
  if (x < 0.0) return uNoData;
  if (uPacked) {
    vec3 c = vec3(ivec3(int(x)) >> ivec3(16, 8, 0) & 255) / 255.0;
    return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), greaterThan(c, vec3(0.04045)));
  }
  int rows = textureSize(uLut, 0).x;
  return texelFetch(uLut, ivec2(min(rows - 1, int(x * float(rows))), 0), 0).rgb;
}

// Where there is neither a texture nor a coarse record.
float bare(int id, float radius, vec3 n) {
  return lambert(texelFetch(uSpheres, place(id), 0).xyz + radius * n, n);
}

void main() { // the depth test leaves out what nothing covers
  int id = int(texelFetch(uIds, ivec2(gl_FragCoord.xy), 0).r) - 1;
  vec4 s = sphereAt(id);
  vec3 ray, facing;
  float t = hit(s, gl_FragCoord.xy, ray, facing), luminance;
  vec3 n = uBasis * facing;
  ${reader ? `
  int generation${complete ? " = 0, record = id" : ", record = recordOf(id, generation)"};${coarse ? `
  // First light tells more than a texture of another light.
  if (record >= 0 && generation != uCurrent && texelFetch(uCoarse, place(id), 0).x >= 0.0) record = -1;` : ""}
  if (record >= 0) luminance = ${filtered ? "filtered(record, generation, s.w, facing, t, ray)" : "textured(record, generation, n)"};` : ""}
  ${complete ? "" : `${reader ? "else " : ""}{${coarse ? `
    vec4 c = texelFetch(uCoarse, place(id), 0);
    luminance = c.x < 0.0 ? bare(id, s.w, n) : uCoarseScale * max(0.0, c.x + dot(c.yzw, n));` : `
    luminance = bare(id, s.w, n);`}
  }`}
  outSum = vec4(luminance * colorOf(id), luminance);
  outCover = 1.0;
}`;

/** Every uStep-th pixel of the id buffer, for reading back. */
export const SWEEP_FRAGMENT = HEAD + `
uniform usampler2D uIds;
uniform int uStep;
uniform vec2 uFirst;
uniform vec2 uSize;
out uint outId;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy) * uStep + ivec2(uFirst);
  outId = all(lessThan(at, ivec2(uSize))) ? texelFetch(uIds, at, 0).r : 0u;
}`;

/**
 * Sums to a picture: mean, tone curve on luminance, colour, background, sRGB. The same as luxel.kernels.shade.develop.
 * @param {boolean} whole whether pixels of sums are pixels of the picture
 */
export const presentFragment = (whole) => HEAD + `
uniform sampler2D uSum, uCover;
uniform vec2 uCanvas;   // pixels shown
uniform vec2 uPart;     // part of the sums that is in use, (0, 1]
uniform float uCount, uExposure, uWhite;
uniform vec3 uTop, uBottom; // background, linear light
out vec4 outColor;

vec3 encode(vec3 c) {
  return mix(c * 12.92, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308)));
}

void main() {
  vec2 at = gl_FragCoord.xy / uCanvas;
  ${whole ? `
  vec4 sum = texelFetch(uSum, ivec2(gl_FragCoord.xy), 0);
  float hits = texelFetch(uCover, ivec2(gl_FragCoord.xy), 0).r;` : `
  vec4 sum = texture(uSum, at * uPart);
  float hits = texture(uCover, at * uPart).r;`}
  float cover = min(1.0, hits / uCount), gain = 0.0;
  if (sum.a > 0.0 && hits > 0.0) {
    float v = sum.a / hits * uExposure;
    if (uWhite > 1.0) {
      float toe = pow(uWhite, -0.6), high = toe * uWhite;
      v *= toe;
      v = v * (1.0 + v / (high * high)) / (1.0 + v);
    }
    gain = min(v, 1.0) * cover / sum.a;
  }
  vec3 c = encode(clamp(sum.rgb * gain + mix(uBottom, uTop, at.y) * (1.0 - cover), 0.0, 1.0));
  // A slow gradient shows steps in 8 bits; half a step of noise hides them where there is only background.
  float noise = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715)))) - 0.5;
  outColor = vec4(c + noise * (1.0 - cover) / 255.0, 1);
}`;
