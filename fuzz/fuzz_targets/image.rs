//! Any bytes as EXR, HDR, PNG or JPEG: an image that decodes has as many values as it says.

#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(image) = eclipse::image_io::decode_image(bytes, std::path::Path::new("image"), None) {
        assert_eq!(
            image.data.len(),
            image.width * image.height * image.channels
        );
    }
});
