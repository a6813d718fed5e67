//! Renders the truth of a capture and compares it with its photographs.
use std::path::Path;
use eclipse::image_io::read_exr;
use glam::{Mat4, Vec3};
use rayon::prelude::*;
use render::bsdf::{Material, Model};
use render::bvh::Bvh;
use render::camera::Camera;
use render::environment::EnvironmentMap;
use render::mesh::Mesh;
use render::reference::Reference;
use std::io::Write;

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let dir = Path::new(&args[1]);
    let stride: usize = args[2].parse().unwrap();
    let mode = args[3].as_str();
    let json: serde_json::Value = serde_json::from_slice(&std::fs::read(dir.join("transforms.json")).unwrap()).unwrap();
    let truth: serde_json::Value = serde_json::from_slice(&std::fs::read(dir.join("truth/truth.json")).unwrap()).unwrap();
    let mesh = glb(&dir.join("mesh.glb"));
    let bvh = Bvh::new(&mesh).unwrap();
    let env = EnvironmentMap::new(read_exr(&dir.join("truth/environment.exr")).unwrap()).unwrap();
    let model = if truth["bsdf"] == "lambert" { Model::Lambertian } else { Model::Microfacet };
    let (alpha, kappa) = (truth["alpha"].as_f64().unwrap() as f32, truth["kappa"].as_f64().unwrap() as f32);
    let g = env.grid();
    let mits = render::convention::convert(env.image(), render::convention::Convention::Blender, render::convention::Convention::Mitsuba, g, glam::Mat3::IDENTITY);
    let fine = render::lat_long::LatLong::new(400, 800);
    let mback = EnvironmentMap::new(render::convention::convert(&mits, render::convention::Convention::Mitsuba, render::convention::Convention::Blender, fine, glam::Mat3::IDENTITY)).unwrap();
    let reference = match mode {
        "bilinear" => Reference::new(&bvh, &env, model, 4),
        "nearest" => Reference::with_radiance(&bvh, g, |d| { let t = g.nearest(d); [0, 1, 2].map(|c| env.image().data[3 * t + c]) }, model, 4),
        _ => Reference::with_radiance(&bvh, g, |d| mback.radiance(d), model, 4),
    };
    let mut out = std::io::BufWriter::new(std::fs::File::create(&args[4]).unwrap());
    let t = std::time::Instant::now();
    for (f, frame) in json["frames"].as_array().unwrap().iter().enumerate() {
        if f % args.get(5).map_or(4, |s| s.parse().unwrap()) != 0 { continue; }
        let m: Vec<f32> = frame["transform_matrix"].as_array().unwrap().iter().flat_map(|r| r.as_array().unwrap().iter().map(|v| v.as_f64().unwrap() as f32)).collect();
        let w = json["w"].as_u64().unwrap() as usize;
        let camera = Camera::from_fov(w, w, json["camera_angle_x"].as_f64().unwrap() as f32, Mat4::from_cols_slice(&m).transpose());
        let image = read_exr(&dir.join(frame["file_path"].as_str().unwrap())).unwrap();
        let albedo = read_exr(&dir.join(format!("truth/albedo_{f:03}.exr"))).unwrap();
        let pixels: Vec<usize> = (0..w * w).filter(|p| (p.wrapping_mul(2654435761) >> 8) % stride == 0 && image.data[p * image.channels + 3] > 0.0).collect();
        let rows: Vec<String> = pixels.par_iter().map(|&p| {
            let (i, j) = (p % w, p / w);
            let a = albedo.pixel(i, j);
            let value = reference.pixel(&camera, [i, j], None, |_| Material { albedo: [a[0], a[1], a[2]], alpha, kappa });
            let seen = bvh.seen(&camera, i as f32 + 0.5, j as f32 + 0.5);
            let (nv, ngv, pos) = seen.map_or((-1.0, -1.0, Vec3::ZERO), |(s, o)| (s.normal.dot(o), s.geometric_normal.dot(o), s.position));
            let o = image.pixel(i, j);
            format!("{f},{i},{j},{},{},{},{},{},{},{},{},{nv},{ngv},{},{},{},{},{},{}\n", value[0], value[1], value[2], value[3], o[0], o[1], o[2], o[3], a[0], a[1], a[2], pos.x, pos.y, pos.z)
        }).collect();
        for r in rows { out.write_all(r.as_bytes()).unwrap(); }
    }
    println!("{:?}", t.elapsed());
}

fn glb(path: &Path) -> Mesh {
    let b = std::fs::read(path).unwrap();
    let word = |o: usize| u32::from_le_bytes(b[o..o + 4].try_into().unwrap()) as usize;
    let n = word(12);
    let j: serde_json::Value = serde_json::from_slice(&b[20..20 + n]).unwrap();
    let bin = 28 + n;
    let start = |k: usize| bin + j["bufferViews"][j["accessors"][k]["bufferView"].as_u64().unwrap() as usize]["byteOffset"].as_u64().unwrap_or(0) as usize;
    let count = |k: usize| j["accessors"][k]["count"].as_u64().unwrap() as usize;
    let vec3 = |k: usize| -> Vec<Vec3> { (0..count(k)).map(|i| { let f = |c: usize| f32::from_bits(word(start(k) + 12 * i + 4 * c) as u32); Vec3::new(f(0), -f(2), f(1)) }).collect() };
    Mesh { positions: vec3(0), normals: vec3(1), uvs: vec![], faces: (0..count(2) / 3).map(|i| [0, 1, 2].map(|c| word(start(2) + 12 * i + 4 * c) as u32)).collect() }
}
