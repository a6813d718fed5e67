//! Any bytes as EXR, HDR, PNG or JPEG: an image that decodes has as many values as it says, and its header alone the same size.

#![no_main]

use std::path::Path;

use eclipse::image_io::{decode_image, decode_size, decode_turn};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let path = Path::new("image");
    let size = decode_size(bytes, path);
    let turn = decode_turn(bytes, path);
    let Ok(image) = decode_image(bytes, path, None) else {
        return;
    };
    assert_eq!(
        image.data.len(),
        image.width * image.height * image.channels
    );
    let size = size.expect("the size of an image that decodes");
    assert_eq!([size.width, size.height], [image.width, image.height]);
    if let Some(turn) = turn {
        let shown = turn.shown(&image);
        assert_eq!([shown.width, shown.height], [image.height, image.width]);
    }
});
