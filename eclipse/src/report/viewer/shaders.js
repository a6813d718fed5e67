// The object under light from all directions (WebGL 2). World z up; layers of gathered light as light.js makes them.
const COMMON = `#version 300 es
precision highp float;
precision highp sampler2DArray;
const float PI = 3.14159265358979;
uniform float turn;      // of the light about z, radians
uniform float exposure;  // from radiance over its mean to display
// Equirectangular: centre column +x, azimuth falling to the right.
vec2 grid(vec3 d) {
  return vec2(0.5 - (atan(d.y, d.x) - turn) / (2.0 * PI), acos(clamp(d.z, -1.0, 1.0)) / PI);
}
vec3 display(vec3 linear) {
  vec3 v = clamp(linear, 0.0, 1.0);
  return mix(12.92 * v, 1.055 * pow(v, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, v));
}
`;

const OBJECT_VERTEX = `#version 300 es
precision highp float;
in vec4 place;    // xyz in the box, κ
in vec4 normal;   // xyz, √α
in vec3 albedo;   // as sRGB
uniform mat4 clipFromWorld;
uniform vec3 low, extent;
out vec3 position, facing;
out vec3 diffuse;
out vec2 gloss;
vec3 linear(vec3 v) { return mix(v / 12.92, pow((v + 0.055) / 1.055, vec3(2.4)), step(0.04045, v)); }
void main() {
  position = low + extent * place.xyz;
  facing = normal.xyz;
  diffuse = linear(albedo);
  gloss = vec2(normal.w, place.w);
  gl_Position = clipFromWorld * vec4(position, 1.0);
}`;

const OBJECT_FRAGMENT = `${COMMON}
in vec3 position, facing, diffuse;
in vec2 gloss;
uniform vec3 eye;
uniform float coated, layers, kappaWhite;
uniform int shown;
uniform sampler2D map, brdf;
uniform sampler2DArray lobes;
out vec4 colour;
// The mean over a lobe of roughness r around d: between the layers on either side, the map itself for a mirror.
vec3 lobe(vec3 d, float r) {
  vec2 at = grid(d);
  float level = 10.0 * r - 2.0;
  if (level < 0.0) return mix(textureLod(map, at, 0.0).rgb, textureLod(lobes, vec3(at, 0.0), 0.0).rgb, 0.5 * level + 1.0);
  float below = min(floor(level), layers - 3.0);
  return mix(textureLod(lobes, vec3(at, below), 0.0).rgb, textureLod(lobes, vec3(at, below + 1.0), 0.0).rgb, level - below);
}
void main() {
  vec3 n = normalize(facing), o = normalize(eye - position);
  float r = gloss.x, kappa = gloss.y;
  if (shown == 1) { colour = vec4(display(diffuse), 1.0); return; }
  if (shown == 2) { colour = vec4(vec3(r * r), 1.0); return; }
  // White where it is in the page's own pictures.
  if (shown == 3) { colour = vec4(vec3(kappa / kappaWhite), 1.0); return; }
  if (shown == 4) { colour = vec4(0.5 + 0.5 * n, 1.0); return; }
  float cosine = max(dot(n, o), 1e-3);
  vec3 light = diffuse * textureLod(lobes, vec3(grid(n), layers - 1.0), 0.0).rgb;
  if (coated > 0.5) {
    // What the coat lets in and out again: (1 − F) of the light's side is in the layer, but for the factor 1 − κ.
    float grazing = 1.0 - sqrt(0.5 + 0.5 * cosine), g2 = grazing * grazing;
    light *= (1.0 - kappa) * (1.0 - kappa) * (1.0 - g2 * g2 * grazing);
    vec2 share = textureLod(brdf, vec2(cosine, r), 0.0).xy;
    light += (kappa * share.x + share.y) * lobe(reflect(-o, n), r);
  }
  colour = vec4(display(exposure * light), 1.0);
}`;

const BACKDROP_VERTEX = `#version 300 es
out vec2 place;
void main() {
  place = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(place, 1.0, 1.0);
}`;

const BACKDROP_FRAGMENT = `${COMMON}
in vec2 place;
uniform vec3 right, up, forward;
uniform sampler2D map;
out vec4 colour;
void main() {
  vec3 d = normalize(forward + place.x * right + place.y * up);
  colour = vec4(display(exposure * textureLod(map, grid(d), 0.0).rgb), 1.0);
}`;
